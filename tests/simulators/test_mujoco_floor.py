"""The floor's push on the wheels of the explicit car, beside MuJoCo's own contacts."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's compiled module has no type stubs.

import mujoco
import numpy as np
import pytest

from buggy_rl.core.vehicle import GRAVITY, VehicleDimensions
from buggy_rl.simulators.mujoco.car import car_mjcf, make_car
from buggy_rl.simulators.mujoco.declared import declared_parameters
from buggy_rl.simulators.mujoco.floor import Floor
from buggy_rl.simulators.mujoco.forces import Forces
from buggy_rl.simulators.mujoco.weights import WHEELS

DIMENSIONS = VehicleDimensions()
CAR = make_car(DIMENSIONS, "explicit", 0.0025)
FLOOR = Floor(CAR)
VALUES = {p.name: np.array([p.value]) for p in declared_parameters(DIMENSIONS)}
WEIGHT = 1.625 * GRAVITY  # [N]


def own_data(model):
    data = mujoco.MjData(model)
    data.qpos[:] = CAR.parked
    return data


def stepped(model, data, steering=0.0, drive=0.0, steps=1, contacts=False):
    """Pushes [steps, 4] of the floor; with contacts MuJoCo's take their place."""
    forces, pushes = Forces(CAR, VALUES), []
    qpos, qvel = data.qpos[None], data.qvel[None]
    xfrc, qfrc = data.xfrc_applied[None], data.qfrc_applied[None]
    for _ in range(steps):
        forces.apply(qpos, qvel, xfrc, qfrc, np.array([steering]), np.array([drive]))
        pushes.append(data.xfrc_applied[CAR.wheel_bodies, 2].copy())
        if contacts:
            data.xfrc_applied[CAR.wheel_bodies, 2] = 0.0
        mujoco.mj_step(model, data)
    return np.array(pushes)


def test_heights_and_speeds_are_those_that_mujoco_computes_of_a_tilted_car():
    data, rng = own_data(CAR.model), np.random.default_rng(1)
    data.qpos[2:7] = [0.06, 0.9, 0.12, -0.08, 0.4]
    data.qpos[3:7] /= np.linalg.norm(data.qpos[3:7])
    data.qpos[CAR.slide + 1] = rng.normal(0, 0.004, 4)
    data.qvel[:] = rng.normal(0, 1, CAR.model.nv)
    mujoco.mj_forward(CAR.model, data)
    height, speed = FLOOR.heights(data.qpos[None], data.qvel[None])
    kind, motion = mujoco.mjtObj.mjOBJ_XBODY, np.zeros(6)
    for wheel, body in enumerate(CAR.wheel_bodies):
        mujoco.mj_objectVelocity(CAR.model, data, kind, body, motion, 0)
        assert height[wheel, 0] == pytest.approx(data.xpos[body, 2] - DIMENSIONS.wheel_radius)
        assert speed[wheel, 0] == pytest.approx(motion[5])


def test_the_floor_pushes_what_is_carried_and_more_where_a_wheel_sinks():
    qpos, qvel = CAR.parked[None].repeat(3, 0), np.zeros((3, CAR.model.nv))
    qpos[1, 2] -= 0.001  # m
    qvel[2, 2] = -0.1  # m/s
    push = FLOOR.push(qpos, qvel, np.full((4, 3), 4.0))
    # m = 0.03 + 0.2 kg, T = 10 ms: m z / T^2 = 2.3 N, 2 m v / T = 4.6 N
    np.testing.assert_allclose(push, [[4.0, 6.3, 8.6]] * 4)


def test_the_floor_never_pulls():
    qpos, qvel = CAR.parked[None].repeat(2, 0), np.zeros((2, CAR.model.nv))
    qpos[0, 2] += 0.01
    qvel[1, 2] = 0.5
    assert (FLOOR.push(qpos, qvel, np.full((4, 2), 4.0)) == 0.0).all()


def test_at_rest_and_in_a_steady_turn_the_wheels_carry_the_weight():
    data = own_data(CAR.model)
    resting = stepped(CAR.model, data, steps=40)
    np.testing.assert_allclose(resting.sum(1), WEIGHT, rtol=1e-3)
    assert np.abs(data.qvel).max() < 1e-3
    turning = stepped(CAR.model, data, steering=0.2, drive=0.25, steps=1600)[-400:].mean(0)
    assert turning.sum() == pytest.approx(WEIGHT, rel=1e-3)
    left, right = turning[[0, 2]].sum(), turning[[1, 3]].sum()
    assert right > left + 1.0  # N: the body leans outwards


def test_a_car_that_falls_lands_on_its_wheels_and_comes_to_rest():
    data = own_data(CAR.model)
    data.qpos[2] += 0.02  # m
    assert (stepped(CAR.model, data, steps=10) == 0.0).all()  # in the air
    pushes = stepped(CAR.model, data, steps=600)
    assert (pushes >= 0.0).all()
    np.testing.assert_allclose(pushes[-1].sum(), WEIGHT, rtol=1e-3)
    assert data.qpos[2] == pytest.approx(DIMENSIONS.cg_height, abs=1e-4)


def with_contacts():
    """The same car on four frictionless spheres, which MuJoCo's solver holds."""
    root = car_mjcf(DIMENSIONS, "explicit", 0.0025)
    for wheel in WHEELS:
        root.find("body", wheel).add(
            "geom",
            type="sphere",
            size=[DIMENSIONS.wheel_radius],
            mass=0,
            condim=1,
            priority=1,
            solimp=(0.99, 0.99, 0.001),
        )
    return mujoco.MjModel.from_xml_string(root.to_xml_string())


@pytest.mark.parametrize(("steering", "drive"), [(0.3, 0.4), (-0.36, 1.0), (0.1, 0.15)])
def test_a_second_ends_where_mujocos_contacts_would_have_it(steering, drive):
    ends, loads = [], []
    for model in (CAR.model, with_contacts()):
        data = own_data(model)
        contacts = model is not CAR.model
        loads.append(stepped(model, data, steering, drive, 400, contacts))
        assert data.ncon == (4 if contacts else 0)
        ends.append(data.qpos[:2].copy())
    way = np.linalg.norm(ends[0])
    assert way > 0.05  # m
    assert np.linalg.norm(ends[0] - ends[1]) < 5e-3 * way
