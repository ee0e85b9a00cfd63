"""One buggy as a dm_control environment, for dm_control's tools or TorchRL's wrapper.

Model, actuators and forces are those of the batched engine, behind dm_control `Physics`:

    DMControlWrapper(make_environment())

Its state is in the physics and not in a TensorDict, so it is no simulator of this package:
`make_engine` refuses it, and its engine `mujoco` is the car to the last bit.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's compiled module has no type stubs.

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
from dm_control import mjcf
from dm_control.rl import control
from dm_env import specs
from numpy.typing import NDArray

from buggy_rl.core import keys
from buggy_rl.core.vehicle import CONTROL_PERIOD, VehicleDimensions
from buggy_rl.simulators.mujoco.actuators import RESTING, Actuators, memory_length
from buggy_rl.simulators.mujoco.car import CompiledCar, Tyres, make_car, model_fields
from buggy_rl.simulators.mujoco.declared import declared_parameters
from buggy_rl.simulators.mujoco.engine import default_timestep, whole_substeps
from buggy_rl.simulators.mujoco.forces import Forces
from buggy_rl.simulators.mujoco.placement import park, place, seen_pose, seen_velocity, set_off


class BuggyPhysics(mjcf.Physics):
    """Physics of dm_control that applies the car's forces before every substep.

    `equip` must be called once after `from_mjcf_model`.
    """

    car: CompiledCar
    actuators: Actuators
    forces: Forces

    def equip(self, car: CompiledCar, values: Mapping[str, NDArray], dt: float) -> None:
        """Gives the compiled model its parameter values [1] and its actuators."""
        self.car = car
        for name, field in model_fields(car, values).items():
            getattr(self.model, name)[:] = field[0]
        mujoco.mj_setConst(self.model.ptr, self.data.ptr)
        self.actuators = Actuators(values, dt)
        self.forces = Forces(car, values)
        self._memory = np.tile(RESTING, (1, memory_length(dt), 1))
        self.set_down(np.zeros(3), np.zeros(3))

    def set_down(self, pose: NDArray, velocity: NDArray) -> None:
        """Starts at `pose` [3] with `velocity` [3], without drive, springs settled."""
        data = self.data
        qpos, qvel = data.qpos[None], data.qvel[None]
        park(self.car, qpos, qvel)
        place(qpos, qvel, pose[None])
        set_off(self.car, qpos, qvel, velocity[None])
        self._memory[:] = RESTING
        self._lagged = self._target = np.array([RESTING])
        self._yaw = pose[2:]

    def command(self, action: NDArray) -> None:
        """Takes the action [2] of the next control period."""
        action = np.asarray(action, np.float32).clip(-1.0, 1.0).astype(np.float64)
        self._target = self.actuators.delayed(self._memory, action[None])
        self._memory = np.concatenate([self._memory[:, 1:], action[None, None]], 1)

    def step(self, nstep: int = 1) -> None:
        """Advances by one control period of `nstep` substeps."""
        data, timestep = self.data, self.timestep()
        qpos, qvel = data.qpos[None], data.qvel[None]
        xfrc, qfrc = data.xfrc_applied[None], data.qfrc_applied[None]
        with self.check_invalid_state():
            for substep in range(nstep):
                middle = self.actuators.lagged(
                    self._lagged, self._target, (substep + 0.5) * timestep
                )
                angle = self.actuators.steering_angle(middle[:, 1])
                drive = self.actuators.drive(middle[:, 0])
                self.forces.apply(qpos, qvel, xfrc, qfrc, angle, drive)
                mujoco.mj_step(self.model.ptr, data.ptr)
        self._lagged = self.actuators.lagged(self._lagged, self._target, nstep * timestep)
        self._yaw = self.pose()[2:]

    def pose(self) -> NDArray:
        """x, y [m], yaw [rad], world frame; yaw is not wrapped."""
        return seen_pose(self.data.qpos[None], self._yaw)[0]

    def velocity(self) -> NDArray:
        """vx, vy [m/s], yaw rate [rad/s], body frame."""
        return seen_velocity(self.data.qpos[None], self.data.qvel[None])[0]


class DriveTask(control.Task):
    """The car without a task: no reward, no termination.

    Args:
        pose: [3] at the start of an episode.
        velocity: [3] likewise.
    """

    def __init__(self, pose=(0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0)) -> None:
        self.pose = np.asarray(pose, np.float64)
        self.velocity = np.asarray(velocity, np.float64)
        self._random = np.random.RandomState(0)  # TorchRL's wrapper seeds it; it is not used

    def initialize_episode(self, physics: BuggyPhysics) -> None:
        """Starts an episode."""
        physics.set_down(self.pose, self.velocity)

    def before_step(self, action: NDArray, physics: BuggyPhysics) -> None:
        """Passes the action to the actuators."""
        physics.command(action)

    def after_step(self, physics: BuggyPhysics) -> None:
        """Does nothing."""

    def action_spec(self, physics: BuggyPhysics) -> specs.BoundedArray:
        """Throttle, steering in [-1, 1]."""
        return specs.BoundedArray((2,), np.float32, -1.0, 1.0, name=keys.ACTION)

    def get_observation(self, physics: BuggyPhysics) -> dict[str, NDArray]:
        """Pose [3] and velocity [3], as of every engine."""
        return {
            keys.POSE: physics.pose().astype(np.float32),
            keys.VELOCITY: physics.velocity().astype(np.float32),
        }

    def get_reward(self, physics: BuggyPhysics) -> float:
        """0: tasks are transforms."""
        return 0.0

    def get_termination(self, physics: BuggyPhysics) -> None:
        """Never terminates."""


def make_environment(
    parameters: Mapping[str, float] | None = None,
    dt: float = CONTROL_PERIOD,
    tyres: Tyres = "explicit",
    timestep: float | None = None,
    dimensions: VehicleDimensions | None = None,
    task: DriveTask | None = None,
    **options: Any,
) -> control.Environment:
    """One buggy as a dm_control environment.

    Args:
        parameters: Values that differ from those shipped, by name.
        dt: Control period [s].
        tyres: `explicit` or `contact`.
        timestep: Of the physics [s]; None takes the batched engine's.
        dimensions: Of the car.
        task: Start of the episodes; None: at rest at the origin.
        options: Further arguments of `control.Environment`, such as `time_limit` [s].

    Raises:
        KeyError: A name is not a parameter.
        ValueError: `dt` is not a multiple of `timestep`.
    """
    dimensions = dimensions or VehicleDimensions()
    timestep = default_timestep(tyres, dt) if timestep is None else timestep
    values = {p.name: p.value for p in declared_parameters(dimensions)}
    unknown = sorted(set(parameters or {}) - set(values))
    if unknown:
        raise KeyError(f"no parameter {', '.join(unknown)}; available: {', '.join(sorted(values))}")
    values.update(parameters or {})
    car = make_car(dimensions, tyres, timestep)
    physics = BuggyPhysics.from_mjcf_model(car.root)
    # Rounded to float32 like the batched engine's, for equal results to the last bit.
    columns = {name: np.array([np.float32(value)], np.float64) for name, value in values.items()}
    physics.equip(car, columns, dt)
    return control.Environment(
        physics,
        task or DriveTask(),
        n_sub_steps=whole_substeps(dt, timestep),
        legacy_step=False,
        **options,
    )
