"""The car's equations of motion in closed form, beside MuJoCo's step."""

import copy

import mujoco
import numpy as np
import pytest

from buggy_rl.core.longitudinal import LongitudinalCommand
from buggy_rl.core.vehicle import VehicleDimensions, similar_dimensions
from buggy_rl.simulators.mujoco.batches import CpuCars
from buggy_rl.simulators.mujoco.car import make_car, model_fields
from buggy_rl.simulators.mujoco.declared import declared_parameters
from buggy_rl.simulators.mujoco.forces import Forces
from buggy_rl.simulators.mujoco.rigid import RigidCar, read_state, written_state
from buggy_rl.simulators.mujoco.weights import chassis_inertia

CARS = 40
BUGGY, TRUCK = VehicleDimensions(), similar_dimensions({"wheelbase": 0.5, "mass": 9.0})


def values(dimensions, command, rng):
    """Parameters that differ from car to car, by name [n]."""
    declared = declared_parameters(dimensions, None, LongitudinalCommand.of(command))
    share = {p.name: rng.uniform(0.9, 1.1, CARS) for p in declared}
    return {p.name: (p.value * share[p.name]).clip(p.lower, p.upper) for p in declared}


@pytest.mark.parametrize("dimensions", [BUGGY, TRUCK], ids=["buggy", "truck"])
@pytest.mark.parametrize(
    ("drive", "command"),
    [("rear", "throttle"), ("all", "speed"), ("front", "throttle_brake_reverse")],
)
def test_a_step_is_that_of_mujoco(dimensions, drive, command):
    rng = np.random.default_rng(3)
    car = make_car(dimensions, "explicit", 0.0025, visual=False, drive=drive)
    own = values(dimensions, command, rng)
    cars = CpuCars(car.model, CARS, model_fields(car, own))
    forces, rigid = Forces(car, own, LongitudinalCommand.of(command)), RigidCar(car, own)
    cars.qpos[:], cars.qvel[:] = car.parked, 0.0
    # Tilted, turning, on struts that move: more than any drive does.
    cars.qpos[:, 3:7] += rng.normal(0, 0.05, (CARS, 4))
    cars.qpos[:, 3:7] /= np.linalg.norm(cars.qpos[:, 3:7], axis=1, keepdims=True)
    cars.qpos[:, car.slide + 1] += rng.normal(0, 0.001, (CARS, 4))
    cars.qvel[:, :6] = rng.normal(0, 1.0, (CARS, 6))
    cars.qvel[:, car.slide] = rng.normal(0, 0.1, (CARS, 4))
    cars.qvel[:, car.spin] = rng.normal(30, 20, (CARS, 4))
    for _ in range(5):
        angle, throttle = rng.uniform(-0.4, 0.4, CARS), rng.uniform(0, 1, CARS)
        applied = forces.applied(cars.qpos, cars.qvel, angle, throttle)
        before = read_state(car, cars.qpos, cars.qvel)
        qpos, qvel = written_state(car, rigid.step(before, applied, angle), angle)
        forces.apply(cars.qpos, cars.qvel, cars.xfrc_applied, cars.qfrc_applied, angle, throttle)
        cars.step()
        moved = np.delete(np.arange(car.model.nv), car.steer)
        np.testing.assert_allclose(qvel[:, moved], cars.qvel[:, moved], atol=5e-6, rtol=1e-6)
        kept = np.delete(np.arange(car.model.nq), car.spin + 1)
        # MuJoCo's front wheels give way to the tyres, as far as their servo's inertia lets them.
        np.testing.assert_allclose(qpos[:, kept], cars.qpos[:, kept], atol=1e-6, rtol=0)
        assert not cars._batch.warning[..., 1].any()


def test_the_chassis_is_that_of_the_model():
    own = {"mass": np.array([1.4, 1.8]), "yaw_inertia": np.array([0.004, 0.006])}
    own["cg_to_front_axle"] = np.array([0.08, 0.1])
    car = make_car(BUGGY, "explicit", 0.0025, visual=False)
    found, expected = RigidCar(car, own), chassis_inertia(BUGGY, *own.values())
    np.testing.assert_allclose(found.mass, expected["mass"])
    np.testing.assert_allclose(found.centre[0], expected["ipos"][:, 0], atol=1e-12)
    np.testing.assert_allclose(found.centre[1], expected["ipos"][:, 2])
    np.testing.assert_allclose(np.stack(found.inertia, -1), expected["inertia"])


def test_a_car_that_flies_keeps_its_momentum_and_falls():
    rng = np.random.default_rng(5)
    own = values(BUGGY, "throttle", rng)
    car = make_car(BUGGY, "explicit", 0.0025, visual=False)
    qpos, qvel = np.tile(car.parked, (CARS, 1)), rng.normal(0, 2.0, (CARS, car.model.nv))
    qpos[:, 2] += 1.0
    qvel[:, car.steer] = 0.0
    rigid, none = RigidCar(car, own), np.zeros((4, CARS))
    nothing = Forces(car, own).applied(qpos, qvel, np.zeros(CARS), np.zeros(CARS))
    nothing = nothing._replace(
        along_x=none, along_y=none, push=none, torque=none, resistance=(none[0], none[0])
    )
    state, start = read_state(car, qpos, qvel), momentum(car, own, qpos, qvel)
    for _ in range(20):
        state = rigid.step(state, nothing, np.zeros(CARS))
    qpos, qvel = written_state(car, state, np.zeros(CARS))
    change = momentum(car, own, qpos, qvel) - start
    np.testing.assert_allclose(change[:, :2], 0.0, atol=3e-2)  # of first order in the step
    np.testing.assert_allclose(change[:, 2], -9.81 * 0.05 * own["mass"], rtol=5e-2)


def momentum(car, own, qpos, qvel):
    """Linear momentum [n, 3] of cars, by MuJoCo's subtree sensor."""
    model = copy.copy(car.model)
    found, data = [], mujoco.MjData(model)
    fields = model_fields(car, own)
    for row in range(len(qpos)):
        for name, field in fields.items():
            getattr(model, name)[:] = field[row]
        data.qpos[:], data.qvel[:] = qpos[row], qvel[row]
        mujoco.mj_forward(model, data)
        mujoco.mj_subtreeVel(model, data)
        found.append(data.subtree_linvel[0] * model.body_subtreemass[0])
    return np.array(found)
