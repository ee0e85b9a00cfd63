"""Commands on their way to wheels and motor."""

import numpy as np
import pytest

from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.simulators.mujoco.actuators import Actuators, memory_length, motor_torque
from buggy_rl.simulators.mujoco.declared import declared_parameters

DT = 0.01  # [s]


def actuators(**changes):
    values = {p.name: p.value for p in declared_parameters(VehicleDimensions())}
    values.update(changes)
    return Actuators({name: np.atleast_1d(np.float64(v)) for name, v in values.items()}, DT)


def played(actuators, signal):
    """What gets through of a steering signal [T] with nothing before it."""
    memory = np.zeros((1, memory_length(DT), 2))
    heard = []
    for value in signal:
        action = np.array([[0.0, value]])
        heard.append(actuators.delayed(memory, action)[0, 1])
        memory = np.concatenate([memory[:, 1:], action[:, None]], 1)
    return heard


@pytest.mark.parametrize(
    ("dead_time", "expected"),
    [
        (0.0, [1, 2, 3, 4, 5]),
        (0.02, [0, 0, 1, 2, 3]),
        # 25 ms are two and a half periods: half of the one, half of the next
        (0.025, [0, 0, 0.5, 1.5, 2.5]),
        (0.029, [0, 0, 0.1, 1.1, 2.1]),
    ],
)
def test_a_command_is_heard_a_dead_time_late(dead_time, expected):
    heard = played(actuators(steering_dead_time=dead_time), [1, 2, 3, 4, 5])
    np.testing.assert_allclose(heard, expected, atol=1e-12)


def test_the_longest_dead_time_is_remembered():
    heard = played(actuators(steering_dead_time=0.2), np.arange(1, 31))
    np.testing.assert_allclose(heard[20:], np.arange(1, 11), atol=1e-12)
    assert not np.any(heard[:20])


@pytest.mark.parametrize("dead_time", [-0.01, 0.21])
def test_a_dead_time_beyond_the_memory_is_refused(dead_time):
    with pytest.raises(ValueError, match=r"must be within 0 to 0\.2 s"):
        actuators(steering_dead_time=dead_time)


def test_dead_times_differ_from_car_to_car():
    several = actuators(steering_dead_time=np.array([0.0, 0.01, 0.015]))
    memory = np.zeros((3, memory_length(DT), 2))
    memory[:, -1, 1] = 4.0
    memory[:, -2, 1] = 2.0
    heard = several.delayed(memory, np.tile([0.0, 6.0], (3, 1)))
    np.testing.assert_allclose(heard[:, 1], [6.0, 4.0, 3.0])


def test_a_lag_reaches_63_percent_after_its_time_constant():
    lagged = actuators(steering_lag=0.05).lagged(np.zeros((1, 2)), np.ones((1, 2)), 0.05)
    assert lagged[0, 1] == pytest.approx(1 - np.exp(-1))


def test_two_short_lags_are_one_long_one():
    car, start, target = actuators(), np.array([[0.2, -0.4]]), np.array([[1.0, 0.3]])
    once = car.lagged(start, target, 0.01)
    twice = car.lagged(car.lagged(start, target, 0.004), target, 0.006)
    np.testing.assert_allclose(twice, once, rtol=1e-12)


def test_no_lag_follows_at_once():
    lagged = actuators(steering_lag=0.0).lagged(np.zeros((1, 2)), np.ones((1, 2)), 1e-3)
    assert lagged[0, 1] == 1.0


def test_left_and_right_lock_differ_about_the_offset():
    car = actuators(steering_left=0.3, steering_right=0.4, steering_offset=0.05)
    angles = car.steering_angle(np.array([-1.0, -0.5, 0.0, 0.5, 1.0]))
    # 0.05 - 0.4, 0.05 - 0.2, 0.05, 0.05 + 0.15, 0.05 + 0.3
    np.testing.assert_allclose(angles, [-0.35, -0.15, 0.05, 0.2, 0.35], atol=1e-12)


def test_below_the_deadband_there_is_no_drive_and_full_throttle_is_full_drive():
    # deadband 0.2: throttle -0.6 is drive 0.2, throttle 0.2 is (0.6 - 0.2) / 0.8 = 0.5
    drive = actuators(throttle_deadband=0.2).drive(np.array([-1.0, -0.6, 0.2, 1.0]))
    np.testing.assert_allclose(drive, [0.0, 0.0, 0.5, 1.0], atol=1e-12)


def test_the_motor_pulls_less_the_faster_it_turns():
    values = {"drive_force": np.array([20.0]), "drive_speed_loss": np.array([4.0])}
    # 50 and 70 rad/s on 0.03 m are 1.8 m/s in the mean: 0.5 (20 - 4 * 1.8) = 6.4 N,
    # half of it on each wheel: 6.4 * 0.03 / 2 = 0.096 N m
    torque, slope = motor_torque(values, np.array([0.5]), np.array([[50.0], [70.0]]), 0.03)
    assert torque[0] == pytest.approx(0.096)
    # -0.5 * 4 * 0.03^2 / 2
    assert slope[0] == pytest.approx(-0.0009)
