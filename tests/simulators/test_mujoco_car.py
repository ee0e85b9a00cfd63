"""The compiled model: what it weighs, how it stands, what pushes it."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's compiled module has no type stubs.

import mujoco
import numpy as np
import pytest

from buggy_rl.core.vehicle import GRAVITY, VehicleDimensions
from buggy_rl.simulators.mujoco.car import make_car, model_fields
from buggy_rl.simulators.mujoco.declared import declared_parameters
from buggy_rl.simulators.mujoco.forces import Forces, read_motion
from buggy_rl.simulators.mujoco.placement import park, place, seen_pose, seen_velocity, set_off
from buggy_rl.simulators.mujoco.weights import chassis_inertia

DIMENSIONS = VehicleDimensions()
CAR = make_car(DIMENSIONS, "explicit", 0.0025)


def values(**changes):
    shipped = {p.name: p.value for p in declared_parameters(DIMENSIONS)} | changes
    return {name: np.atleast_1d(np.float64(value)) for name, value in shipped.items()}


def model_and_data(**changes):
    """MuJoCo's own model and data with parameter values written in."""
    model = mujoco.MjModel.from_xml_string(CAR.root.to_xml_string())
    data = mujoco.MjData(model)
    for name, field in model_fields(CAR, values(**changes)).items():
        getattr(model, name)[:] = field[0]
    mujoco.mj_setConst(model, data)  # leaves the springs slack in `data`
    mujoco.mj_resetData(model, data)
    mujoco.mj_forward(model, data)
    return model, data


def stand(steps, **changes):
    """MuJoCo's data and the car's forces after so many steps at rest."""
    model, data = model_and_data(**changes)
    forces, still = Forces(CAR, values(**changes)), np.zeros(1)
    views = [getattr(data, n)[None] for n in ("qpos", "qvel", "xfrc_applied", "qfrc_applied")]
    for _ in range(steps):
        forces.apply(*views, still, still)
        mujoco.mj_step(model, data)
    return data, forces


HEAVY = {"mass": 2.1, "yaw_inertia": 0.007, "cg_to_front_axle": 0.095}


@pytest.mark.parametrize(
    ("changes", "mass", "inertia", "cg_x"),
    # the sensor is 22 mm ahead of the centre of gravity; 14 mm further back makes 36 mm
    [({}, 1.625, 0.0049, -0.022), (HEAVY, 2.1, 0.007, -0.036)],
)
def test_the_whole_car_has_the_mass_inertia_and_centre_asked_for(changes, mass, inertia, cg_x):
    model, data = model_and_data(**changes)
    assert model.body_subtreemass[CAR.chassis] == pytest.approx(mass)
    centre = data.subtree_com[CAR.chassis] - data.xpos[CAR.chassis]
    np.testing.assert_allclose(centre, [cg_x, 0.0, 0.0], atol=1e-12)
    matrix = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, matrix)
    # about the body frame: the parallel axes add m d^2
    assert matrix[5, 5] == pytest.approx(inertia + mass * cg_x**2)


def test_what_only_the_eye_needs_weighs_nothing_and_touches_nothing():
    bare = make_car(DIMENSIONS, "explicit", 0.0025, visual=False)
    assert bare.model.ngeom == 1  # a floor, which touches nothing either
    assert make_car(DIMENSIONS, "contact", 0.001, visual=False).model.ngeom == 5  # and four tyres
    assert CAR.model.ngeom > 15
    np.testing.assert_array_equal(bare.model.body_mass, CAR.model.body_mass)
    np.testing.assert_array_equal(bare.parked, CAR.parked)


def test_wheels_that_weigh_more_than_the_car_are_refused():
    with pytest.raises(ValueError, match="leaves none for the chassis"):
        chassis_inertia(DIMENSIONS, 1.0, 0.001, 0.08)


@pytest.mark.parametrize("changes", [{}, HEAVY])
def test_it_stands_level_whatever_it_weighs(changes):
    data, _ = stand(800, **changes)  # 2 s
    up = data.xmat[CAR.chassis].reshape(3, 3)[2, 2]
    assert np.arccos(min(up, 1.0)) < 2e-3  # rad
    assert data.qpos[2] == pytest.approx(DIMENSIONS.cg_height, abs=5e-4)  # m
    assert np.abs(data.qvel).max() < 1e-4


def test_the_axles_carry_the_car_by_the_rule_of_levers():
    data, forces = stand(1200)  # 3 s
    loads = forces.loads(data.qpos[None], data.qvel[None])[:, 0]
    # front: 1.625 * 9.80665 * 0.093 / 0.174 = 8.517 N, rear the rest of 15.936 N
    np.testing.assert_allclose(loads[:2], 8.517 / 2, rtol=1e-3)
    np.testing.assert_allclose(loads[2:], 7.418 / 2, rtol=1e-3)
    floor = data.xfrc_applied[CAR.wheel_bodies, 2].sum()
    assert loads.sum() == pytest.approx(floor, rel=1e-3)
    assert loads.sum() == pytest.approx(1.625 * GRAVITY, rel=1e-3)


def test_applied_tyre_forces_stay_within_the_friction_circle():
    rng = np.random.default_rng(0)
    n, grip = 500, {"grip_front": 0.8, "grip_rear": 0.6}
    forces = Forces(CAR, values(**grip))
    qpos, qvel = np.repeat(CAR.parked[None], n, 0), rng.normal(0, 1.0, (n, CAR.model.nv))
    qpos[:, CAR.slide + 1] += rng.normal(0, 0.004, (n, 4))
    qvel[:, CAR.slide] *= 0.1
    qvel[:, CAR.spin] *= 60
    xfrc, qfrc = np.zeros((n, CAR.model.nbody, 6)), np.zeros((n, CAR.model.nv))
    forces.apply(qpos, qvel, xfrc, qfrc, rng.uniform(-0.5, 0.5, n), rng.uniform(0, 1, n))
    size = np.linalg.norm(xfrc[:, CAR.wheel_bodies, :2], axis=-1).T  # (4, n)
    limit = np.array([0.8, 0.8, 0.6, 0.6])[:, None] * forces.loads(qpos, qvel)
    assert (size <= limit * (1 + 1e-9)).all()
    assert (size > 0.95 * limit).mean() > 0.2  # and many are at the limit


def test_a_car_set_down_somewhere_is_seen_there():
    pose = np.array([[1.0, -2.0, 2.5], [0.0, 3.0, -9.0]])
    velocity = np.array([[1.5, 0.2, -0.8], [0.0, -0.4, 2.0]])
    qpos, qvel = np.empty((2, CAR.model.nq)), np.empty((2, CAR.model.nv))
    park(CAR, qpos, qvel)
    place(qpos, qvel, pose)
    set_off(CAR, qpos, qvel, velocity)
    np.testing.assert_allclose(seen_pose(qpos, pose[:, 2]), pose, atol=1e-12)
    np.testing.assert_allclose(seen_velocity(qpos, qvel), velocity, atol=1e-12)


def test_what_is_seen_is_what_mujoco_says_of_a_tilted_car():
    model, data = model_and_data()
    rng = np.random.default_rng(3)
    data.qpos[3:7] = [0.9, 0.1, -0.05, 0.4]
    data.qpos[3:7] /= np.linalg.norm(data.qpos[3:7])
    data.qvel[:] = rng.normal(0, 1, model.nv)
    mujoco.mj_forward(model, data)
    world = np.zeros(6)  # rotation, then translation, both in world axes
    body = mujoco.mjtObj.mjOBJ_XBODY  # the body frame, not its centre of mass
    mujoco.mj_objectVelocity(model, data, body, CAR.chassis, world, 0)
    ahead = data.xmat[CAR.chassis].reshape(3, 3)[:2, 0]
    ahead /= np.linalg.norm(ahead)
    motion = read_motion(data.qpos[None], data.qvel[None])
    assert motion.yaw_rate[0] == pytest.approx(world[2])
    assert motion.vx[0] == pytest.approx(ahead @ world[3:5])
    assert motion.vy[0] == pytest.approx(ahead[0] * world[4] - ahead[1] * world[3])


def test_wheels_speed_up_with_the_floor_under_them():
    qpos, qvel = np.empty((1, CAR.model.nq)), np.empty((1, CAR.model.nv))
    park(CAR, qpos, qvel)
    set_off(CAR, qpos, qvel, np.array([[1.3, 0.0, 0.0]]))
    np.testing.assert_allclose(qvel[0, CAR.spin], 1.3 / 0.0325)  # 40 rad/s
    qvel[0, CAR.spin] += 5.0  # spinning wheels keep their 5 rad/s
    set_off(CAR, qpos, qvel, np.array([[2.6, 0.0, 0.0]]))
    np.testing.assert_allclose(qvel[0, CAR.spin], 85.0)


def test_unknown_tyres_are_refused():
    with pytest.raises(ValueError, match="expected 'explicit' or 'contact'"):
        make_car(DIMENSIONS, "magic", 0.0025)  # type: ignore[arg-type]
