"""Composed physics: each primitive does what it says, and none is an effect of the library."""

import math

import pytest
import torch
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.proof.plants.composed import (
    COMMANDS,
    FORCES,
    PLAY,
    SEEN,
    SORTS,
    UNNAMED,
    Disturbance,
    Sort,
    is_composed,
)

ROWS = 400


def state(cars=3, vx=2.0, yaw_rate=1.0, throttle=0.2, steering=0.5):
    velocity = torch.tensor([vx, 0.0, yaw_rate]).expand(cars, 3)
    action = torch.tensor([throttle, steering]).expand(cars, 2)
    content = {keys.POSE: torch.zeros(cars, 3), keys.VELOCITY: velocity, keys.ACTION: action}
    return TensorDict(content, [cars]).clone()


def responses(name, signal, **numbers):
    """What is added, over time, for a course of the steering command."""
    disturbance = Disturbance(name, {"size": 1.0, **numbers})
    added = []
    for value in signal:
        now = state(1, steering=float(value))
        before = now[keys.VELOCITY].clone()
        after = disturbance.acting(now)[keys.VELOCITY]
        added.append(float((after - before)[0, FORCES[disturbance.sort.where]]) / CONTROL_PERIOD)
    return torch.tensor(added)


def test_there_are_hundreds_of_sorts_and_every_place_has_some():
    assert len(SORTS) > 300
    assert {Sort.named(name).where for name in SORTS} == {*FORCES, *COMMANDS, *SEEN}
    assert all(str(Sort.named(name)) == name for name in SORTS)


@pytest.mark.parametrize(
    "name",
    [
        "forward.speed.linear.none",  # viscous drag
        "forward.speed.square.none",  # aerodynamic drag
        "forward.lateral.even.none",  # cornering drag
        "yaw.yaw_rate.linear.none",  # yaw damping
        "steering.steering.linear.lag",  # steering lag
        "steering.steering.linear.play",  # backlash
        "throttle.time.linear.none",  # battery
        "seen_speed.speed.linear.none",  # speed scale
    ],
)
def test_what_the_library_has_is_no_sort(name):
    assert not is_composed(name)
    Sort.named(name)  # though its primitives are there


@pytest.mark.parametrize(
    "name",
    [
        "forward.steering.even.none",  # steering drag
        "steering.lateral.linear.none",  # understeer by compliance
        "yaw.throttle.linear.none",  # torque steer
        "seen_yaw.time.linear.none",  # heading drift
    ],
)
def test_what_the_library_has_since_is_read_and_no_longer_unnamed(name):
    assert is_composed(name)  # shipped ledgers hold it
    assert name not in UNNAMED
    assert len(UNNAMED) > 500


@pytest.mark.parametrize("wrong", ["forward.speed", "up.speed.linear.none", "yaw.time.cubic.lag"])
def test_a_name_that_is_no_sort_is_refused(wrong):
    with pytest.raises(ValueError, match=r"where\.signal|no primitive"):
        Sort.named(wrong)


@pytest.mark.parametrize("name", SORTS[::7])
def test_a_sort_acts_where_it_says_and_nowhere_else(name):
    numbers = {"size": 0.3, "time_constant": 0.2, "phase": 0.4}
    disturbance, sort, now = Disturbance(name, numbers), Sort.named(name), state()
    for _ in range(30):
        before = now.clone()
        now[keys.POSE] += 0.02
        after = disturbance.acting(now.clone())
        motion = disturbance.seen(before) if sort.where in SEEN else before
        for key in (keys.POSE, keys.VELOCITY, keys.ACTION):
            assert bool(torch.isfinite(after[key]).all())
            assert bool(torch.isfinite(motion[key]).all())
    moved = (after[keys.VELOCITY] != now[keys.VELOCITY]).any(0)
    steered = (after[keys.ACTION] != now[keys.ACTION]).any(0)
    assert set(moved.nonzero().flatten().tolist()) <= {FORCES.get(sort.where)}
    assert set(steered.nonzero().flatten().tolist()) <= {COMMANDS.get(sort.where)}
    assert torch.equal(after[keys.POSE], now[keys.POSE])


def test_the_shapes_are_the_equations():
    x = torch.linspace(-1, 1, 41)
    expected = {
        "linear": x,
        "even": x.abs(),
        "square": x * x.abs(),
        "saturating": torch.tanh(3 * x),
        "threshold": torch.sign(x) * (x.abs() - 0.4).clamp_min(0) / 0.6,
    }
    moving = math.tanh(2.0 / 0.1)
    for shape, y in expected.items():
        torch.testing.assert_close(
            responses(f"forward.steering.{shape}.none", x), moving * y, atol=2e-5, rtol=1e-4
        )


def test_a_lag_is_of_first_order_and_play_holds_until_it_is_taken_up():
    step = torch.ones(ROWS)
    lagged = responses("forward.steering.linear.lag", step, time_constant=0.5)
    time = CONTROL_PERIOD * torch.arange(1, ROWS + 1)
    torch.testing.assert_close(lagged, 1 - torch.exp(-time / 0.5), atol=1e-4, rtol=1e-4)
    back = torch.tensor([1.0, 1.0 - PLAY, 1.0 - 2 * PLAY, 1.0 - 3 * PLAY])
    held = responses("forward.steering.linear.play", back)
    torch.testing.assert_close(held, torch.tensor([1, 1, 1, 1 - PLAY]) - PLAY, atol=1e-4, rtol=0)


def test_heat_rises_with_the_square_whatever_the_sign():
    one, other = (
        responses("forward.steering.linear.heat", side * torch.ones(ROWS), time_constant=5.0)
        for side in (1, -1)
    )
    assert torch.equal(one, other)
    assert bool((one.diff() > 0).all())


def test_nothing_pushes_a_car_at_rest():
    disturbance = Disturbance("forward.time.linear.none", {"size": 5.0})
    now = state(vx=0.0, yaw_rate=0.0)
    for _ in range(50):
        now = disturbance.acting(now)
    assert float(now[keys.VELOCITY].abs().max()) == 0.0


def test_a_sensor_shows_it_and_the_car_does_not_move_by_it():
    disturbance = Disturbance("seen_yaw.time.linear.none", {"size": 0.05})
    now = state(ROWS)
    assert disturbance.acting(now) is now
    seen = disturbance.seen(now)
    added = (seen[keys.POSE] - now[keys.POSE])[:, 2]
    expected = 0.05 * CONTROL_PERIOD * torch.arange(1, ROWS + 1) / 30.0
    torch.testing.assert_close(added, expected, atol=1e-6, rtol=1e-4)
    assert torch.equal(disturbance.seen(now)[keys.POSE], seen[keys.POSE])  # it starts anew
