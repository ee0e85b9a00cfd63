"""A simulator of a user's own MJCF file: a car on a free joint, with actuators by name.

State in the TensorDict, after the batch dimensions: `physics_state` [nq + nv + na + 6] in float64,
that is qpos, qvel, act, and the pose and velocity last returned, by which an edit is noticed.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's compiled module has no type stubs.

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec
from torchrl.envs import EnvBase

from buggy_rl.core import keys
from buggy_rl.core.longitudinal import LongitudinalCommand, drive_of
from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.simulators.base import RowsEngine
from buggy_rl.simulators.mujoco.batches import CpuCars
from buggy_rl.simulators.mujoco.engine import PHYSICS_STATE, whole_substeps
from buggy_rl.simulators.mujoco.placement import place, seen_pose, seen_velocity

SETTLING = 0.3  # [s] of imposed motion at a reset, in which springs settle and wheels begin to roll


class MjcfEngine(RowsEngine):
    """M(q) dv/dt + c(q, v) = tau(u): a user's model; see `from_mjcf`."""

    vehicle: Any = None  # of this car nothing is known: a diagnosis measures it

    def __init__(
        self,
        *args: Any,
        xml: str,
        drive: Sequence[str],
        steering: Sequence[str],
        body: str,
        full_drive: float | None = None,
        full_steering: float | None = None,
        command: str | Mapping[str, Any] | LongitudinalCommand = "throttle",
        nthread: int = 1,
        **common: Any,
    ) -> None:
        super().__init__(*args, **common)
        self.command = LongitudinalCommand.of(command)
        self._given = {"xml": xml, "drive": drive, "steering": steering, "body": body,
                       "full_drive": full_drive, "full_steering": full_steering,
                       "command": self.command, "nthread": nthread}  # fmt: skip
        self.model = loaded(xml)
        self._substeps = whole_substeps(self.dt, self.model.opt.timestep)
        self._qpos, self._qvel = _free_joint(self.model, body)
        self._drive = _actuators(self.model, drive, full_drive, "full_drive")
        self._steering = _actuators(self.model, steering, full_steering, "full_steering")
        self._cars = CpuCars(self.model, max(self.numel(), 1), {}, nthread)
        self._finish()

    def _latent_specs(self) -> dict[str, TensorSpec]:
        size = self.model.nq + self.model.nv + self.model.na + 6
        return self._number_specs({PHYSICS_STATE: (size,)}, self._cars.dtype)

    def _rest_latent(self, pose: Tensor, velocity: Tensor) -> dict[str, Tensor]:
        poses, velocities = self._rows(pose), self._rows(velocity)
        cars, resting = self._cars, np.tile([self.command.rest, 0.0], (len(poses), 1))
        start = self.model.key_qpos[0] if self.model.nkey else self.model.qpos0
        cars.qpos[:], cars.qvel[:], cars.act[:] = start, 0.0, 0.0
        for _ in range(round(SETTLING / self.dt)):
            self._set(cars.qpos, cars.qvel, poses, velocities)
            self._run(resting)
        self._set(cars.qpos, cars.qvel, poses, velocities)
        return {PHYSICS_STATE: self._packed(poses, velocities)}

    def _advance(self, state: TensorDictBase, action: Tensor) -> dict[str, Tensor]:
        physics = self._rows(state[PHYSICS_STATE])
        pose, velocity = self._rows(state[keys.POSE]), self._rows(state[keys.VELOCITY])
        cars, nq, nv = self._cars, self.model.nq, self.model.nv
        cars.qpos[:], cars.qvel[:] = physics[:, :nq], physics[:, nq : nq + nv]
        cars.act[:] = physics[:, nq + nv : -6]
        new = (physics[:, -6:] != np.concatenate([pose, velocity], 1)).any(1)
        if new.any():  # others edited it
            qpos, qvel = cars.qpos[new], cars.qvel[new]
            self._set(qpos, qvel, pose[new], velocity[new])
            cars.qpos[new], cars.qvel[new] = qpos, qvel
        self._run(self._rows(action))
        body, motion = cars.qpos[:, self._qpos], cars.qvel[:, self._qvel]
        next_pose = self._tensor(seen_pose(body, pose[:, 2])).float()
        next_velocity = self._tensor(seen_velocity(body, motion)).float()
        packed = self._packed(self._rows(next_pose), self._rows(next_velocity))
        return {keys.POSE: next_pose, keys.VELOCITY: next_velocity, PHYSICS_STATE: packed}

    def _run(self, action: NDArray) -> None:
        """Advances all cars by a control period under commands [n, 2]."""
        ctrl = self._cars.ctrl
        drive = drive_of(action[:, 0], self.command.rest)
        for share, actuators in ((drive, self._drive), (action[:, 1], self._steering)):
            for index, full in actuators.items():
                ctrl[:, index] = share * full
        for _ in range(self._substeps):
            self._cars.step()
        (self._cars.lose_bad if self.lost_as_nan else self._cars.refuse_bad)()

    def _set(self, qpos: NDArray, qvel: NDArray, pose: NDArray, velocity: NDArray) -> None:
        """Gives cars poses and velocities [n, 3]; height, pitch, roll and joints stay."""
        body, motion = qpos[:, self._qpos], qvel[:, self._qvel]
        place(body, motion, pose)
        change = velocity - seen_velocity(body, motion)
        cos, sin = np.cos(pose[:, 2]), np.sin(pose[:, 2])
        motion[:, 0] += cos * change[:, 0] - sin * change[:, 1]
        motion[:, 1] += sin * change[:, 0] + cos * change[:, 1]
        w, x, y, z = body[:, 3:7].T
        up = [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]
        motion[:, 3:6] += np.stack(up, -1) * change[:, 2:]

    def _packed(self, pose: NDArray, velocity: NDArray) -> Tensor:
        cars = self._cars
        return self._tensor(np.concatenate([cars.qpos, cars.qvel, cars.act, pose, velocity], 1))

    def _options(self) -> dict[str, Any]:
        return dict(self._given)


def loaded(xml: str | Path) -> "mujoco.MjModel":
    """The model of a file or of MJCF text, of which a step depends on nothing but its state.

    Raises:
        ValueError: There is no such file, or MuJoCo cannot read it.
    """
    text = str(xml)
    try:
        if text.lstrip().startswith("<"):
            model = mujoco.MjModel.from_xml_string(text)
        else:
            if not Path(text).is_file():
                raise ValueError(f"there is no MJCF file {text}")
            model = mujoco.MjModel.from_xml_path(text)
    except ValueError as error:
        raise ValueError(f"from_mjcf: {' '.join(str(error).split())}") from None
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_WARMSTART
    return model


def _free_joint(model: "mujoco.MjModel", body: str) -> tuple[slice, slice]:
    """Places of a body's free joint in qpos and qvel.

    Raises:
        ValueError: There is no such body, or it has none.
    """
    free = {
        model.body(int(model.jnt_bodyid[j])).name: j
        for j in range(model.njnt)
        if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE
    }
    if body not in free:
        raise ValueError(
            f"from_mjcf: body={body!r}: must be a body with a free joint; there are: "
            f"{', '.join(map(repr, free)) or 'none; give the chassis a <freejoint/>'}"
        )
    qpos, qvel = model.jnt_qposadr[free[body]], model.jnt_dofadr[free[body]]
    return slice(qpos, qpos + 7), slice(qvel, qvel + 6)


def _actuators(
    model: "mujoco.MjModel", names: Sequence[str], full: float | None, option: str
) -> dict[int, float]:
    """Index of each actuator and its control at full command.

    Raises:
        ValueError: There is no such actuator, or nothing says what full is.
    """
    known = [model.actuator(i).name for i in range(model.nu)]
    result = {}
    for name in names:
        if name not in known:
            raise ValueError(
                f"from_mjcf: no actuator {name!r}; there are: {', '.join(map(repr, known))}"
            )
        index = known.index(name)
        if full is None and not model.actuator_ctrllimited[index]:
            raise ValueError(
                f"from_mjcf: actuator {name!r} has no ctrlrange: add one, or pass {option}= , its "
                "control at full command"
            )
        result[index] = float(model.actuator_ctrlrange[index][1]) if full is None else full
    return result


def from_mjcf(
    xml: str | Path,
    *,
    drive: str | Sequence[str],
    steering: str | Sequence[str],
    body: str,
    full_drive: float | None = None,
    full_steering: float | None = None,
    dt: float = CONTROL_PERIOD,
    command: str | Mapping[str, Any] = "throttle",
    nthread: int = 1,
) -> Callable[[int, str], EnvBase]:
    """A simulator from an MJCF file.

    Pose and velocity are those of the origin of `body`, whose x axis points forward. A reset
    imposes the velocity for 0.3 s, so that the wheels roll; an edit changes the chassis alone.

    Args:
        xml: A file, or MJCF text.
        drive: Actuators that the throttle moves; their control is drive times `full_drive`, drive
            0..1, or -1..1 of a command with reverse.
        steering: Actuators that the steering moves, by the command times `full_steering`.
        body: The chassis: a body with a free joint.
        full_drive: Control at full throttle; by default the upper end of each ctrlrange.
        full_steering: Control at full steering to the left, likewise; negative where the actuator
            is positive to the right.
        dt: Control period [s], a multiple of the model's timestep.
        command: Kind of the first command (docs/recordings.md): `throttle`: no reverse, -1 is no
            drive.
        nthread: Threads of MuJoCo's batch; results do not depend on it.

    Returns:
        factory(batch_size, device).

    Raises:
        ValueError: The file cannot be read, or has no such actuator or body.
    """
    names = [[each] if isinstance(each, str) else list(each) for each in (drive, steering)]
    given: dict[str, Any] = {
        "xml": str(xml),
        "drive": names[0],
        "steering": names[1],
        "body": body,
        "full_drive": full_drive,
        "full_steering": full_steering,
        "command": command,
        "nthread": nthread,
        "dt": dt,
    }
    MjcfEngine(1, **given)  # what is wrong with it is said where it is written
    return partial(MjcfEngine, **given)
