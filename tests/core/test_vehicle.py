import math

import pytest
import torch
from torch.testing import assert_close

from buggy_rl.core.vehicle import (
    integrate_pose,
    planar_norm,
    rotate,
    shift_pose,
    shift_velocity,
    side_by_side_columns,
    slip_angle,
    wrap_angle,
)


def test_columns_are_each_contiguous():
    speed, zero = torch.ones(4, 2), torch.zeros(())
    both = side_by_side_columns(speed, zero)
    assert_close(both, torch.stack([speed, torch.zeros(4, 2)], -1))
    assert both[..., 0].is_contiguous()


def test_a_length_is_that_of_its_sides_and_has_a_gradient_at_rest():
    sides = torch.tensor([[3.0, 4.0], [0.0, 1e-6], [0.0, 0.0]], requires_grad=True)
    found = planar_norm(*sides.unbind(-1))
    assert_close(found, torch.tensor([5.0, 1e-6, 0.0]))
    found.sum().backward()
    assert_close(sides.grad, torch.tensor([[0.6, 0.8], [0.0, 1.0], [0.0, 0.0]]))


def test_a_quarter_turn_to_the_left_takes_x_to_y():
    assert_close(
        rotate(torch.tensor([1.0, 0.0]), torch.tensor(math.pi / 2)), torch.tensor([0.0, 1.0])
    )


def test_wrapped_angles_lie_within_half_a_turn_and_differ_by_whole_turns():
    angle = torch.linspace(-20, 20, 401)
    wrapped = wrap_angle(angle)
    assert wrapped.min() >= -math.pi
    assert wrapped.max() < math.pi
    turns = (angle - wrapped) / (2 * math.pi)
    assert_close(turns, turns.round(), atol=1e-5, rtol=0)


def test_constant_velocity_in_a_circle_comes_back_after_one_turn():
    # 1 m/s at 2 pi rad/s: radius 1 / (2 pi) m, one turn in 1 s.
    velocity = torch.tensor([1.0, 0.0, 2 * math.pi], dtype=torch.float64)
    pose = torch.zeros(3, dtype=torch.float64)
    furthest = 0.0
    for _ in range(100):
        pose = integrate_pose(pose, velocity, velocity, 0.01)
        furthest = max(furthest, pose[1].item())
    assert_close(pose[:2], torch.zeros(2, dtype=torch.float64), atol=1e-12, rtol=0)
    assert furthest == pytest.approx(1 / math.pi, rel=1e-3)  # the diameter


@pytest.mark.parametrize("order", [2])
def test_pose_integration_converges_at_second_order(order: int):
    # vx = t, r = 1: x(1) = int t cos t dt = sin 1 + cos 1 - 1, y(1) = sin 1 - cos 1.
    exact = torch.tensor([math.sin(1) + math.cos(1) - 1, math.sin(1) - math.cos(1)])
    errors = []
    for steps in (10, 20):
        pose, dt = torch.zeros(3, dtype=torch.float64), 1 / steps
        for step in range(steps):
            ends = [torch.tensor([t * dt, 0.0, 1.0], dtype=torch.float64) for t in (step, step + 1)]
            pose = integrate_pose(pose, *ends, dt)
        errors.append((pose[:2] - exact).norm().item())
    assert math.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.1)


def test_a_point_ahead_of_a_turning_car_moves_sideways():
    # r = 2 rad/s, 0.5 m ahead: 1 m/s to the left on top.
    moved = shift_velocity(torch.tensor([3.0, 0.0, 2.0]), 0.5)
    assert_close(moved, torch.tensor([3.0, 1.0, 2.0]))


def test_shifting_pose_and_velocity_agree():
    dt, velocity = 1e-3, torch.tensor([1.0, 0.2, 3.0], dtype=torch.float64)
    pose = torch.tensor([0.3, -0.1, 0.7], dtype=torch.float64)
    there = shift_pose(integrate_pose(pose, velocity, velocity, dt), 0.2, -0.1)
    shifted = shift_velocity(velocity, 0.2, -0.1)
    expected = integrate_pose(shift_pose(pose, 0.2, -0.1), shifted, shifted, dt)
    assert_close(there, expected, atol=1e-9, rtol=0)


def test_slip_angle_is_positive_when_the_wheel_moves_to_the_left_of_where_it_points():
    sliding_left = torch.tensor([1.0, 1.0, 0.0])
    assert slip_angle(sliding_left, 0.0, 0.1).item() == pytest.approx(math.pi / 4)
    straight, steered_left = torch.tensor([1.0, 0.0, 0.0]), 0.2
    assert slip_angle(straight, steered_left, 0.1).item() == pytest.approx(-0.2)
    # Turning left (r = 1) moves the rear axle to the right: atan2(-0.1, 1).
    assert slip_angle(torch.tensor([1.0, 0.0, 1.0]), 0.0, -0.1).item() == pytest.approx(-0.0996687)
