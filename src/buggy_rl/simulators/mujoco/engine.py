"""A batch of MuJoCo buggies as a TorchRL environment.

State in the TensorDict, after the batch dimensions:

- `physics_state` [nq + nv + 6]: qpos, qvel, and the pose and velocity last returned, by which an
  edit is noticed. A step depends on nothing else: MuJoCo's warm start is off.
- `commands` [N, 2]: the last N actions, oldest first, for the dead times.
- `actuators` [2]: throttle and steering command behind their lags.

The first and the last are float64, of another backend than `cpu` float32.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import torch
from array_api_compat import array_namespace
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec

from buggy_rl.core import keys
from buggy_rl.core.longitudinal import LongitudinalCommand
from buggy_rl.core.parameters import Realisations
from buggy_rl.core.vehicle import CONTROL_PERIOD, Similarity, VehicleDimensions, similar_dimensions
from buggy_rl.simulators.base import RowsEngine
from buggy_rl.simulators.mujoco.actuators import FRONT_SHARE, Actuators, Drive, memory_length
from buggy_rl.simulators.mujoco.arrays import Array, copied, on_gpu
from buggy_rl.simulators.mujoco.batches import Backend, make_cars
from buggy_rl.simulators.mujoco.car import Tyres, make_car
from buggy_rl.simulators.mujoco.declared import declared_parameters, realised
from buggy_rl.simulators.mujoco.forces import Forces
from buggy_rl.simulators.mujoco.placement import park, place, seen_pose, seen_velocity, set_off

PHYSICS_STATE = "physics_state"
COMMANDS = "commands"
ACTUATORS = "actuators"

# Substeps of a control period: the fewest of which twice as many change 1 s paths by less than 1 %
# of their length. Explicit, 1536 random drives over the full range of throttle and steering, at
# 2.5 ms: 0.15 % on average, 0.46 % for one drive in a hundred, 1.09 % at worst (with MuJoCo's
# contacts in place of `Floor` 1.08 %; of 1534 others 0.96 %, at 3.3 ms 1.3 %).
# Contact does not reach it: at 1 ms 0.3 % on average, 1.1 % for one drive in twenty and 7 % for the
# worst of 512, at the limit of friction.
SUBSTEPS: dict[Tyres, int] = {"explicit": 4, "contact": 10}


class MujocoEngine(RowsEngine):
    """Buggy on four sprung wheels, driven at the rear unless said otherwise.

    The parameter values as shipped are a plausible guess, not fitted to any drive.

    Args:
        tyres: `explicit` slip-angle law, or MuJoCo's friction at the `contact`.
        timestep: Of the physics [s], a whole fraction of `dt`; None takes dt over `SUBSTEPS`.
        nthread: Threads of MuJoCo's batch; results do not depend on it.
        dimensions: Of the car, or what is known of it, by name; the rest is a scaled buggy's.
        speed_ratio: Of its speeds to the buggy's; by default sqrt of the ratio of wheelbases.
        command: Kind of the first command, as of `single_track`. A speed controller reads the
            driven wheels.
        drive: Driven wheels: rear, front or all, through open differentials.
        backend: `cpu`, MuJoCo in double precision, on the CPU whatever the device; or `warp`,
            MuJoCo Warp in single precision on the device, for thousands of cars on a GPU; or
            `closed`, the same equations of motion in closed form, likewise: compiled
            (scripts/compile.py) 7800 cars take a sixteenth of MuJoCo's time on a CPU. They have
            explicit tyres and no ends of the struts' travel.
        args, common: As for `Engine`.

    Raises:
        ValueError: `dt` is not a multiple of `timestep`, or an option is unknown.
        ImportError: MuJoCo Warp is not installed.
    """

    resets_alone = True
    reach = 2.0  # drive and steering angle are linear in the command
    _prepared: tuple[str, ...] = ("_cars", "_actuators", "_forces")
    """Attributes that `_prepare` builds."""

    def __init__(
        self,
        *args: Any,
        tyres: Tyres = "explicit",
        timestep: float | None = None,
        nthread: int = 1,
        dimensions: VehicleDimensions | Mapping[str, float] | None = None,
        speed_ratio: float | None = None,
        command: str | Mapping[str, Any] | LongitudinalCommand = "throttle",
        drive: Drive = "rear",
        backend: Backend = "cpu",
        **common: Any,
    ) -> None:
        if not isinstance(dimensions, VehicleDimensions):
            dimensions = similar_dimensions(dimensions or {})
        self.speed_ratio = speed_ratio
        self.command = LongitudinalCommand.of(command)
        brakes = FRONT_SHARE.get(drive, 0.0)  # `make_car` refuses what is no drive
        declared = declared_parameters(dimensions, speed_ratio, self.command, brakes)
        super().__init__(*args, declared=declared, **common)
        if timestep is None:
            timestep = default_timestep(tyres, self.dt)
        self._substeps = whole_substeps(self.dt, timestep)
        self.car = make_car(dimensions, tyres, timestep, visual=False, drive=drive)
        self.nthread = nthread
        self.backend: Backend = backend
        self._prepare()
        self._finish()

    def vehicle(self) -> VehicleDimensions:
        # The sensor keeps its place between the axles when the centre of gravity moves.
        car, own = self.car.dimensions, super().vehicle()
        moved = own.cg_to_front_axle - car.cg_to_front_axle
        return replace(own, sensor_to_cg=round(car.sensor_to_cg + moved, 6))

    def _nominal(self) -> VehicleDimensions:
        return self.car.dimensions

    @property
    def similarity(self) -> Similarity:
        return Similarity.between(self.car.dimensions, speed=self.speed_ratio)

    def _prepare(self) -> None:
        """Builds what depends on parameter values."""
        rows = {name: value.reshape(-1) for name, value in self.values.items()}
        count, threads = max(self.numel(), 1), self.nthread
        self._cars = make_cars(
            self.backend, self.car, count, rows, self.command, threads, self.device
        )
        values = {name: self._cars.array(value) for name, value in rows.items()}
        self._actuators = Actuators(values, self.dt, self.command)
        self._forces = Forces(self.car, values, self.command)

    _parameters_changed = _prepare

    def __getstate__(self) -> dict[str, Any]:
        """State without what `_prepare` builds: a batch of MuJoCo is neither copied nor pickled."""
        state: Any = super().__getstate__()
        return {name: value for name, value in state.items() if name not in self._prepared}

    def __setstate__(self, state: dict[str, Any]) -> None:
        super().__setstate__(state)
        self._prepare()

    @property
    def realises(self) -> Realisations:
        return realised(self.declared)

    def _array(self, tensor: Tensor) -> Array:
        return self._cars.array(tensor)

    def _latent_specs(self) -> dict[str, TensorSpec]:
        state = self.car.model.nq + self.car.model.nv + 6
        shapes = {PHYSICS_STATE: (state,), ACTUATORS: (2,)}
        precise = self._number_specs(shapes, self._cars.dtype)
        return precise | self._number_specs({COMMANDS: (memory_length(self.dt), 2)})

    def _rest_latent(self, pose: Tensor, velocity: Tensor) -> dict[str, Tensor]:
        shape = pose.shape[:-1]  # of all cars, or of some
        poses, velocities = (self._array(part.reshape(-1, 3)) for part in (pose, velocity))
        count = len(poses)
        qpos, qvel = copied(self._cars.qpos[:count]), copied(self._cars.qvel[:count])
        park(self._forces.car, qpos, qvel)
        place(qpos, qvel, poses)
        set_off(self._forces.car, qpos, qvel, velocities)
        state = array_namespace(qpos).concat([qpos, qvel, poses, velocities], axis=-1)
        resting = pose.new_tensor([self.command.rest, 0.0])
        return {
            PHYSICS_STATE: torch.as_tensor(state).reshape(*shape, -1).to(self.device),
            COMMANDS: resting.expand(*shape, memory_length(self.dt), 2).clone(),
            ACTUATORS: resting.to(self._cars.dtype).expand(*shape, 2).clone(),
        }

    @property
    def _alike(self) -> bool:
        return True  # as far as a reset goes: it reads no parameter

    def _advance(self, state: TensorDictBase, action: Tensor) -> dict[str, Tensor]:
        physics = self._rows(state[PHYSICS_STATE])
        pose, velocity = self._rows(state[keys.POSE]), self._rows(state[keys.VELOCITY])
        physics = self._with_edits(physics, pose, velocity)
        commands, command = self._rows(state[COMMANDS]), self._rows(action)
        target = self._actuators.delayed(commands, command)
        start = self._rows(state[ACTUATORS])
        qpos, qvel = self._split(physics)
        self._cars.qpos[:], self._cars.qvel[:] = qpos, qvel
        self._run(start, target)
        qpos[:], qvel[:] = self._cars.qpos, self._cars.qvel
        next_pose = self._tensor(seen_pose(qpos, pose[:, 2])).float()
        next_velocity = self._tensor(seen_velocity(qpos, qvel)).float()
        physics[:, -6:-3], physics[:, -3:] = self._rows(next_pose), self._rows(next_velocity)
        return {
            keys.POSE: next_pose,
            keys.VELOCITY: next_velocity,
            PHYSICS_STATE: self._tensor(physics),
            COMMANDS: torch.cat([state[COMMANDS][..., 1:, :], action.unsqueeze(-2)], -2),
            ACTUATORS: self._tensor(self._actuators.lagged(start, target, self.dt)),
        }

    def _run(self, start: Array, target: Array) -> None:
        """Advances the cars by one control period."""
        cars = self._cars
        cars.run(self._actuators, self._forces, start, target, self._substeps)
        (cars.lose_bad if self.lost_as_nan else cars.refuse_bad)()

    def _with_edits(self, physics: Array, pose: Array, velocity: Array) -> Array:
        """A copy of the physics state, with the edits of pose or velocity since the last step."""
        xp = array_namespace(physics)
        new_pose = (physics[:, -6:-3] != pose).any(1)
        new_velocity = (physics[:, -3:] != velocity).any(1)
        physics = copied(physics)
        for rows, is_pose in ((new_pose, True), (new_velocity, False)):
            # On a GPU the question would wait for all work there; the answer saves work here.
            if not on_gpu(physics) and not rows.any():
                continue
            edited = copied(physics)
            qpos, qvel = self._split(edited)
            if is_pose:
                place(qpos, qvel, pose)
            else:
                set_off(self._forces.car, qpos, qvel, velocity)
            physics = xp.where(rows[:, None], edited, physics)
        return physics

    def _split(self, physics: Array) -> tuple[Array, Array]:
        nq, nv = self.car.model.nq, self.car.model.nv
        return physics[:, :nq], physics[:, nq : nq + nv]

    @property
    def half_step(self) -> dict[str, Any]:
        return {"timestep": self.car.timestep / 2}

    def _options(self) -> dict[str, Any]:
        options: dict[str, Any] = {}
        if self.speed_ratio is not None:
            options["speed_ratio"] = self.speed_ratio
        if self.command.plain != "throttle":
            options["command"] = self.command.plain
        if self.car.drive != "rear":
            options["drive"] = self.car.drive
        if self.backend != "cpu":
            options["backend"] = self.backend
        return options | {
            "tyres": self.car.tyres,
            "timestep": self.car.timestep,
            "nthread": self.nthread,
            "dimensions": self.car.dimensions,
        }


def default_timestep(tyres: Tyres, dt: float) -> float:
    """Physics timestep [s] for a control period [s]."""
    periods = math.ceil(dt / CONTROL_PERIOD - 1e-6)  # a longer one takes as many more steps
    return dt / periods / SUBSTEPS.get(tyres, 1)  # `make_car` refuses what is no tyre model


def whole_substeps(dt: float, timestep: float) -> int:
    """Physics steps in a control period.

    Raises:
        ValueError: It is not a whole number.
    """
    substeps = round(dt / timestep)
    if substeps < 1 or abs(substeps * timestep - dt) > 1e-9:
        raise ValueError(
            f"a timestep of {timestep} s does not divide the control period of {dt} s: "
            "take dt / 2, dt / 3, ..."
        )
    return substeps
