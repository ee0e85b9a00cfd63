"""Steering and rolling of wheels, by hand."""

import numpy as np
import pytest

from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.visual.film import wheels

CAR = VehicleDimensions()
ZERO = np.zeros(1)


def test_a_wheel_rolls_by_distance_over_radius():
    time = np.linspace(0.0, 2.0, 201)
    velocity = np.tile([1.5, 0.0, 0.0], (201, 1))
    roll = wheels.rolled(time, velocity, np.zeros(201), CAR)
    np.testing.assert_allclose(roll[-1], 3.0 / CAR.wheel_radius)  # 1.5 m/s for 2 s
    assert (roll[0] == 0).all()


def test_outer_wheels_roll_faster_in_a_bend():
    # Turning to the left about a point r = 1 m to the left of the rear axle.
    rear = wheels.places(CAR)[2, 0]
    velocity = np.array([[1.0, -rear, 1.0]])  # at the sensor: vy = r x from the axle
    left, right = wheels.spin(velocity, ZERO, CAR)[0, 2:]
    half = CAR.track_width / 2
    assert left == pytest.approx((1 - half) / CAR.wheel_radius)
    assert right == pytest.approx((1 + half) / CAR.wheel_radius)


def test_steered_wheels_that_point_along_their_motion_roll_by_its_speed():
    # The left front wheel moves with (vx - r y, vy + r x); turned that way, it rolls by its length.
    velocity = np.array([[1.0, 0.2, 0.7]])
    x, y = wheels.places(CAR)[0]
    moving = np.array([1.0 - 0.7 * y, 0.2 + 0.7 * x])
    angle = np.array([np.arctan2(moving[1], moving[0])])
    assert wheels.spin(velocity, angle, CAR)[0, 0] == pytest.approx(
        np.hypot(*moving) / CAR.wheel_radius
    )


def test_mirroring_a_motion_swaps_left_and_right():
    velocity, angle = np.array([[1.0, 0.2, 0.7]]), np.array([0.3])
    spin = wheels.spin(velocity, angle, CAR)[0]
    mirrored = wheels.spin(velocity * [1, -1, -1], -angle, CAR)[0]
    np.testing.assert_allclose(mirrored, spin[[1, 0, 3, 2]])
    assert not np.allclose(mirrored, spin)


def test_positive_steering_is_to_the_left_and_ends_at_the_lock():
    assert wheels.steering_angle(np.array([0.5, -0.5, 2.0]), 0.4).tolist() == [0.2, -0.2, 0.4]


def test_wheels_stand_where_the_axles_are():
    places = wheels.places(CAR)
    assert places[0, 0] - places[2, 0] == pytest.approx(CAR.wheelbase)
    assert places[0, 0] == pytest.approx(CAR.cg_to_front_axle - CAR.sensor_to_cg)
    assert (places[[0, 2], 1] > 0).all()  # left
