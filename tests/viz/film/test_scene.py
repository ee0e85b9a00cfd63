"""The scene needs no OpenGL: where everything stands is computed, not drawn."""

import math

import numpy as np
import pytest

from buggy_rl.vehicle import VehicleDimensions
from buggy_rl.viz.film.scene import Look, Scene
from buggy_rl.viz.film.track import Row

CAR = VehicleDimensions()
FRONT = CAR.cg_to_front_axle - CAR.sensor_to_cg


@pytest.fixture(scope="module")
def scene():
    return Scene([Look((0.8, 0.2, 0.2)), Look((0.0, 0.4, 0.6), 0.4)])


def row(pose=(0.0, 0.0, 0.0), wheel_angle=0.0, roll=0.0) -> Row:
    return Row(pose, 1.0, 0.0, 0.0, wheel_angle, roll, 0.0)


def wheel(scene, name):
    return scene.data.body(name).xpos.copy(), scene.data.body(name).xmat.reshape(3, 3).copy()


def test_wheels_stand_on_the_floor_where_the_dimensions_have_them(scene):
    scene.set([row(), row()])
    for axle, x in (("front", FRONT), ("rear", FRONT - CAR.wheelbase)):
        for side, sign in (("left", 1), ("right", -1)):
            place, _ = wheel(scene, f"car_0_wheel_{axle}_{side}")
            expected = [x, sign * CAR.track_width / 2, CAR.wheel_radius]
            assert place == pytest.approx(expected, abs=1e-4)


def test_the_body_is_as_long_as_the_car_and_between_its_wheels(scene):
    scene.set([row(), row()])
    model, data = scene.model, scene.data
    corners = []
    for geom in np.flatnonzero(model.geom_bodyid == model.body("car_0").id):
        middle, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        signs = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
        turn = data.geom_xmat[geom].reshape(3, 3)
        corners.append(data.geom_xpos[geom] + (middle + signs * half) @ turn.T)
    low, high = np.concatenate(corners).min(0), np.concatenate(corners).max(0)
    assert high[0] - low[0] == pytest.approx(CAR.length, rel=0.1)
    assert (low[0] + high[0]) / 2 == pytest.approx(FRONT - CAR.wheelbase / 2, abs=0.01)
    assert low[2] > 0.0
    assert high[1] < CAR.track_width


def test_cars_stand_at_their_poses_and_turn_to_the_left(scene):
    scene.set([row((1.0, 2.0, math.pi / 2)), row((-1.0, 0.5, 0.0))])
    place, _ = wheel(scene, "car_0_wheel_front_left")
    assert place[:2] == pytest.approx([1.0 - CAR.track_width / 2, 2.0 + FRONT], abs=1e-4)
    ghost, _ = wheel(scene, "car_1_wheel_front_left")
    assert ghost[:2] == pytest.approx([-1.0 + FRONT, 0.5 + CAR.track_width / 2], abs=1e-4)


def test_front_wheels_are_steered_to_the_left_and_rear_wheels_are_not(scene):
    scene.set([row(wheel_angle=0.3), row()])
    _, front = wheel(scene, "car_0_wheel_front_right")
    _, rear = wheel(scene, "car_0_wheel_rear_right")
    # Seen from above the axle, y of the wheel, has turned to the left.
    assert front[:2, 1] == pytest.approx([-math.sin(0.3), math.cos(0.3)], abs=1e-6)
    assert rear[:2, 1] == pytest.approx([0.0, 1.0], abs=1e-6)


def test_a_wheel_that_rolls_forwards_moves_forwards_at_its_top(scene):
    scene.set([row(roll=0.2), row()])
    _, turned = wheel(scene, "car_0_wheel_rear_left")
    top = turned @ np.array([0.0, 0.0, 1.0])
    assert top[0] == pytest.approx(math.sin(0.2), abs=1e-6)


def test_only_the_ghost_is_translucent(scene):
    for index, alpha in ((0, 1.0), (1, 0.4)):
        body = scene.model.body(f"car_{index}").id
        own = scene.model.geom_rgba[scene.model.geom_bodyid == body]
        assert own[:, 3] == pytest.approx(alpha)
