"""MuJoCo's model of a film: everything but pixels, so no OpenGL is needed."""

import mujoco
import numpy as np
import pytest

from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.visual.film import wheels
from buggy_rl.visual.film.director import Director
from buggy_rl.visual.film.scene import Scene
from tests.visual.film.tracks import circle, straight

CAR = VehicleDimensions()


@pytest.fixture(scope="module")
def scene():
    return Scene(CAR, ghosts=1)


def shot(car, ghost, time):
    return Director([car, ghost]).shot(time)


def placed(scene, time=1.0):
    scene.place(shot(circle(), straight(y=0.7, name="ghost"), time))
    return scene.data


def test_the_car_stands_where_its_track_has_it(scene):
    data = placed(scene)
    # The circle of 2 m at 1 m/s: half a radian after a second.
    expected = [2 * np.sin(0.5), 2 * (1 - np.cos(0.5)), 0.0]
    np.testing.assert_allclose(data.body("car").xpos, expected, atol=1e-9)
    forward = data.body("car").xmat.reshape(3, 3)[:, 0]
    np.testing.assert_allclose(forward, [np.cos(0.5), np.sin(0.5), 0.0], atol=1e-9)


def test_the_ghost_stands_where_its_own_has_it(scene):
    np.testing.assert_allclose(placed(scene).body("ghost").xpos, [1.0, 0.7, 0.0], atol=1e-9)


def test_wheels_touch_the_floor_at_the_corners_of_the_car(scene):
    data = placed(scene, 0.0)
    for place, (x, y) in zip(wheels.PLACES, wheels.places(CAR), strict=True):
        position = data.body(f"car_{place}").xpos
        np.testing.assert_allclose(position, [x, y, CAR.wheel_radius], atol=1e-9)


def test_wheels_turn_forwards_and_front_wheels_steer_to_the_left(scene):
    before = placed(scene, 0.0).body("car_rear_left").xmat.reshape(3, 3).copy()
    director = Director([straight(speed=0.5), straight(name="ghost")])
    scene.place(director.shot(0.02))  # 1 cm
    after = scene.data.body("car_rear_left").xmat.reshape(3, 3)
    # What was on top has moved ahead by r sin(angle), angle = 1 cm / r.
    top = after @ before.T @ np.array([0.0, 0.0, CAR.wheel_radius])
    assert top[0] == pytest.approx(CAR.wheel_radius * np.sin(0.01 / CAR.wheel_radius))
    scene.place(Director([circle(), straight(name="ghost")]).shot(0.0))  # steering 0.5
    axle = scene.data.body("car_front_left").xmat.reshape(3, 3)[:, 1]
    angle = np.arctan2(-axle[0], axle[1])
    assert angle == pytest.approx(0.5 * wheels.FULL_LOCK)
    rear = scene.data.body("car_rear_left").xmat.reshape(3, 3)[:, 1]
    np.testing.assert_allclose(rear, [0, 1, 0], atol=1e-9)


def test_the_car_is_as_large_as_its_dimensions(scene):
    scene.place(shot(straight(), straight(name="ghost"), 0.0))
    low, high = corners(scene, "car")
    assert high[0] - low[0] == pytest.approx(CAR.length, rel=0.06)
    assert high[1] - low[1] == pytest.approx(CAR.track_width + CAR.wheel_width, rel=0.02)
    assert low[2] == pytest.approx(0.0, abs=1e-3)


def corners(scene, name):
    """Lowest and highest coordinates of a car's meshes."""
    model, data = scene.model, scene.data
    points = []
    for geom in range(model.ngeom):
        mesh = int(model.geom_dataid[geom])
        root = model.body(int(model.body_rootid[model.geom_bodyid[geom]])).name
        if mesh >= 0 and root == name:
            first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
            vertices = model.mesh_vert[first : first + count]
            turn = data.geom_xmat[geom].reshape(3, 3)
            points.append(vertices @ turn.T + data.geom_xpos[geom])
    every = np.concatenate(points)
    return every.min(0), every.max(0)


def test_another_cars_dimensions_make_another_car():
    long = Scene(VehicleDimensions(length=0.4, wheelbase=0.26, cg_to_front_axle=0.12))
    long.place(Director([straight()]).shot(0.0))
    low, high = corners(long, "car")
    assert high[0] - low[0] == pytest.approx(0.4, rel=0.06)
    with pytest.raises(KeyError):
        long.model.body("ghost")


def test_the_ghost_alone_is_translucent(scene):
    alpha = {name: [] for name in ("car", "ghost")}
    for geom in range(scene.model.ngeom):
        root = scene.model.body(int(scene.model.body_rootid[scene.model.geom_bodyid[geom]])).name
        if root in alpha:
            alpha[root].append(float(scene.model.geom_rgba[geom, 3]))
    assert set(alpha["car"]) == {1.0}
    assert max(alpha["ghost"]) < 0.6


def test_nothing_collides_or_falls(scene):
    data = placed(scene)
    assert data.ncon == 0
    height = data.body("car").xpos[2]
    mujoco.mj_step(scene.model, data)
    assert data.body("car").xpos[2] == height


def test_a_shot_with_another_number_of_cars_is_refused(scene):
    with pytest.raises(ValueError, match=r"1 cars for a scene of 2.*ghosts=0"):
        scene.place(Director([straight()]).shot(0.0))


def test_the_model_survives_its_way_to_another_process(scene):
    copy = mujoco.MjModel.from_binary_path("film.mjb", {"film.mjb": scene.binary()})
    assert copy.ngeom == scene.model.ngeom
    np.testing.assert_array_equal(copy.geom_rgba, scene.model.geom_rgba)


def test_a_second_ghost_stands_where_its_own_track_has_it():
    three = Scene(CAR, ghosts=2)
    tracks = [circle(), straight(y=0.7, name="ghost"), straight(y=-0.4, name="another")]
    three.place(Director(tracks).shot(1.0))
    np.testing.assert_allclose(three.data.body("ghost").xpos, [1.0, 0.7, 0.0], atol=1e-9)
    np.testing.assert_allclose(three.data.body("ghost_2").xpos, [1.0, -0.4, 0.0], atol=1e-9)
