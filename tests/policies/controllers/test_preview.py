import math

import pytest
import torch

from buggy_rl.core.longitudinal import LongitudinalCommand
from buggy_rl.policies.controllers.preview import (
    SpeedConfig,
    ahead,
    allowed_speed,
    curvature,
    throttle,
    with_past,
)


def circle(radius, first=0.1, spacing=0.2, waypoints=10):
    """Waypoints on the circle that leaves the origin along x; radius < 0 to the right."""
    angle = (first + spacing * torch.arange(waypoints)) / abs(radius)
    left = math.copysign(1.0, radius)
    return abs(radius) * torch.stack([torch.sin(angle), left * (1 - torch.cos(angle))], -1)


def straight(first=0.1, spacing=0.2, waypoints=10):
    x = first + spacing * torch.arange(waypoints)
    return torch.stack([x, torch.zeros_like(x)], -1)


@pytest.mark.parametrize("radius", [0.6, 1.0, 5.0, -1.0])
def test_points_of_a_circle_have_its_curvature(radius):
    bend = curvature(circle(radius))
    assert bend.shape == (8,)
    torch.testing.assert_close(bend, torch.full((8,), 1 / radius), atol=1e-3, rtol=1e-3)


def test_the_past_of_a_circle_lies_on_the_circle():
    path = with_past(circle(1.0))
    centre = torch.tensor([0.0, 1.0])
    torch.testing.assert_close((path - centre).norm(dim=-1), torch.ones(12))
    # the first waypoint is 0.1 rad on, so the two before it are at -0.1 and -0.3 rad
    expected = torch.tensor(
        [[math.sin(-0.3), 1 - math.cos(0.3)], [math.sin(-0.1), 1 - math.cos(0.1)]]
    )
    torch.testing.assert_close(path[:2], expected, atol=1e-5, rtol=0)


def test_waypoints_after_a_delay_are_those_seen_from_where_the_car_will_be():
    seen = torch.tensor([[1.0, 0.5]])
    # 2 m/s for 0.1 s: 0.2 m nearer
    moved = ahead(seen, torch.tensor([2.0, 0.0, 0.0]), 0.1)
    torch.testing.assert_close(moved, torch.tensor([[0.8, 0.5]]))
    # a quarter turn to the left on the spot: what was ahead is to the right
    turned = ahead(torch.tensor([[1.0, 0.0]]), torch.tensor([0.0, 0.0, math.pi]), 0.5)
    torch.testing.assert_close(turned, torch.tensor([[0.0, -1.0]]), atol=1e-6, rtol=0)


def test_a_car_on_a_circle_stays_on_it_over_a_delay():
    # 2 m/s and 2 rad/s: radius 1 m; 0.1 s on it has gone 0.2 m, one spacing
    later = ahead(circle(1.0), torch.tensor([2.0, 0.0, 2.0]), 0.1)
    torch.testing.assert_close(later[1:], circle(1.0)[:-1], atol=2e-3, rtol=0)


def test_a_bend_allows_the_speed_whose_lateral_acceleration_is_the_limit():
    # v = sqrt(a R) = sqrt(5 * 0.8) = 2 m/s
    config = SpeedConfig(top_speed=9.0, lateral_acceleration=5.0, unseen_speed=9.0)
    speed = allowed_speed(circle(0.8), config)
    torch.testing.assert_close(speed, torch.tensor(2.0), atol=0.01, rtol=0)
    mirrored = allowed_speed(circle(-0.8), config)
    torch.testing.assert_close(speed, mirrored)


def test_a_straight_allows_what_can_be_braked_off_before_what_is_out_of_sight():
    # last waypoint 0.1 + 9 * 0.2 = 1.9 m away: v = sqrt(2^2 + 2 * 1.5 * 1.9) = 3.114 m/s
    config = SpeedConfig(top_speed=9.0, braking=1.5, unseen_speed=2.0)
    torch.testing.assert_close(
        allowed_speed(straight(), config), torch.tensor(3.1145), atol=1e-3, rtol=0
    )
    slow = SpeedConfig(top_speed=2.5, braking=1.5, unseen_speed=2.0)
    assert allowed_speed(straight(), slow) == 2.5


def bend_after(waypoints):
    """A straight of so many waypoints, then a bend of 0.6 m."""
    end = torch.tensor([0.1 + 0.2 * (waypoints - 1), 0.0])
    return torch.cat(
        [straight(waypoints=waypoints), end + circle(0.6, 0.2, waypoints=10 - waypoints)]
    )


def test_a_bend_further_on_slows_the_car_less():
    config = SpeedConfig(top_speed=9.0, unseen_speed=9.0)
    near, far = (allowed_speed(bend_after(n), config) for n in (3, 6))
    assert near < far < allowed_speed(straight(), config)


def test_cars_with_numbers_of_their_own_drive_as_if_alone():
    paths = torch.stack([circle(0.8), straight(), circle(-2.0)])  # (3, 10, 2)
    limits = torch.tensor([[3.0], [6.0]])
    together = allowed_speed(paths, SpeedConfig(lateral_acceleration=limits))
    alone = [allowed_speed(paths, SpeedConfig(lateral_acceleration=a)) for a in (3.0, 6.0)]
    torch.testing.assert_close(together, torch.stack(alone))


def test_throttle_holds_a_speed_and_corrects_it():
    config = SpeedConfig(drive_at_rest=0.2, drive_per_speed=0.05, gain=0.5)
    speed, wanted = torch.tensor([2.0, 1.0, 2.5, 0.0]), torch.tensor([2.0, 2.0, 2.0, 9.0])
    # drive 0.3, 0.3 + 0.5, 0.3 - 0.25, 1 (cut off); throttle = 2 drive - 1
    expected = torch.tensor([-0.4, 0.6, -0.9, 1.0])
    torch.testing.assert_close(throttle(speed, wanted, config), expected)


BRAKED = LongitudinalCommand("throttle_brake_reverse")


@pytest.mark.parametrize(
    ("speed", "wanted", "drive"),
    [
        (2.0, 2.0, 0.2 + 0.07 * 2.0),  # the drive that holds it
        (3.0, 1.0, 0.2 + 0.07 - 0.6 * 2.0),  # below 0: a brake
        (0.2, -5.0, 0.0),  # a car that stands is not reversed
    ],
)
def test_a_car_with_brakes_is_braked_where_one_without_coasts(speed, wanted, drive):
    config = SpeedConfig(drive_at_rest=0.2, drive_per_speed=0.07, gain=0.6)
    speeds = torch.tensor([speed]), torch.tensor([wanted])
    assert throttle(*speeds, config, BRAKED).item() == pytest.approx(max(-1.0, drive), abs=1e-6)
    assert throttle(*speeds, config).item() == pytest.approx(2 * max(0.0, drive) - 1, abs=1e-6)


@pytest.mark.parametrize(("reverse", "expected"), [(False, 2 * 0.4 - 1), (True, 0.4)])
def test_a_speed_command_is_the_speed_that_is_wanted(reverse, expected):
    command = LongitudinalCommand("speed", full_speed=5.0, reverse=reverse)
    given = throttle(torch.tensor([1.0]), torch.tensor([2.0]), SpeedConfig(), command)
    assert given.item() == pytest.approx(expected)
