"""A model stepped for n cars at once: by MuJoCo on the CPU, or by MuJoCo Warp, on a GPU too."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's compiled module has no type stubs.

from collections.abc import Mapping
from typing import Literal, Protocol, get_args

import mujoco
import numpy as np
import torch
from mujoco.batch import Batch
from numpy.typing import NDArray
from torch import Tensor

from buggy_rl.core.longitudinal import LongitudinalCommand
from buggy_rl.simulators.mujoco.actuators import Actuators
from buggy_rl.simulators.mujoco.arrays import Array
from buggy_rl.simulators.mujoco.car import CompiledCar, model_fields
from buggy_rl.simulators.mujoco.closed_cars import ClosedCars
from buggy_rl.simulators.mujoco.forces import Forces

Backend = Literal["cpu", "warp", "closed"]
"""`cpu`: MuJoCo, double precision, always on the CPU. `warp`: MuJoCo Warp, single precision, on the
engine's device. `closed`: the same equations of motion in closed form, likewise."""


class Cars(Protocol):
    """The state of n cars and their physics step; arrays are of NumPy or PyTorch."""

    dtype: torch.dtype
    """Precision of the state."""
    qpos: Array
    """[n, nq]; written before a step, read after it."""
    qvel: Array
    """[n, nv]."""

    def array(self, tensor: Tensor) -> Array:
        """A tensor as an array of this kind, in its precision and on its device."""
        ...

    def run(
        self, actuators: Actuators, forces: Forces, start: Array, target: Array, steps: int
    ) -> None:
        """Advances every car by timesteps of the model.

        Args:
            actuators: Of the cars.
            forces: On them; cars in closed form have none but their parameters'.
            start: [n, 2] throttle and steering command behind the lags, at the start.
            target: [n, 2] those that the lags tend to.
            steps: Timesteps.
        """
        ...

    def refuse_bad(self) -> None:
        """Raises what the physics only counts: states that are not finite, full buffers.

        Raises:
            RuntimeError: There is one.
        """
        ...

    def lose_bad(self) -> None:
        """Makes the states of such cars NaN, which the next step counts again."""
        ...


class SteppedCars:
    """What `Cars` of MuJoCo's own steps have in common."""

    qpos: Array
    qvel: Array
    xfrc_applied: Array
    """[n, nbody, 6]."""
    qfrc_applied: Array
    """[n, nv]."""

    timestep: float
    """[s]"""

    def run(
        self, actuators: Actuators, forces: Forces, start: Array, target: Array, steps: int
    ) -> None:
        written = (self.xfrc_applied, self.qfrc_applied)
        for step in range(steps):
            middle = actuators.lagged(start, target, (step + 0.5) * self.timestep)
            angle = actuators.steering_angle(middle[:, 1])
            drive = actuators.drive(middle[:, 0])
            forces.apply(self.qpos, self.qvel, *written, angle, drive)
            self.step()

    def step(self) -> None:
        """Advances every car by one timestep, under the forces that are written."""
        raise NotImplementedError


def make_cars(
    backend: Backend,
    car: CompiledCar,
    count: int,
    values: Mapping[str, Tensor],
    command: LongitudinalCommand,
    nthread: int,
    device: torch.device,
) -> Cars:
    """Cars of one model that differ by parameters.

    Args:
        backend: What steps them.
        car: The model.
        count: n.
        values: Parameter name -> [n], or [1] where all share it.
        command: What the first command is.
        nthread: Threads of MuJoCo's batch.
        device: Where cars are stepped that are not on the CPU alone.

    Raises:
        ValueError: There is no such backend, or it does not step these tyres.
        ImportError: MuJoCo Warp is not installed.
    """
    if backend not in get_args(Backend):
        raise ValueError(f"backend is {backend!r}; expected one of {', '.join(get_args(Backend))}")
    if backend == "closed":
        return ClosedCars(car, count, values, command, device)
    known = {name: value.double().cpu().numpy() for name, value in values.items()}
    fields = model_fields(car, known)
    if backend == "cpu":
        return CpuCars(car.model, count, fields, nthread)
    try:
        from buggy_rl.simulators.mujoco.warp_cars import WarpCars
    except ModuleNotFoundError as error:
        raise ImportError(
            f"backend=warp needs MuJoCo Warp ({error}): pip install -e '.[gpu]'"
        ) from error
    return WarpCars(car, count, fields, device)


class CpuCars(SteppedCars):
    """Cars stepped by `mujoco.batch`; see `make_cars` and `Cars`."""

    dtype = torch.float64

    def __init__(
        self, model: mujoco.MjModel, count: int, fields: Mapping[str, NDArray], nthread: int = 1
    ) -> None:
        self._made, self.timestep = (model, count, fields, nthread), model.opt.timestep
        self._batch = Batch(model, count, nthread)
        for name, field in fields.items():
            self._batch.expand(name)[:] = field
        self._batch.set_const()
        self.qpos, self.qvel = self._batch.qpos, self._batch.qvel
        self.ctrl, self.act = self._batch.ctrl, self._batch.act
        self.xfrc_applied, self.qfrc_applied = self._batch.xfrc_applied, self._batch.qfrc_applied

    def __reduce__(self) -> tuple[type, tuple]:
        """How a copy is built: cars hold no state between control periods."""
        return CpuCars, self._made

    def array(self, tensor: Tensor) -> NDArray:
        return tensor.detach().to("cpu", torch.float64).numpy()

    def step(self) -> None:
        self._batch.step()

    def lose_bad(self) -> None:
        bad = self._batch.warning[..., 1].any(-1)  # (n,)
        if bad.any():
            self._batch.warning[:] = 0
            self.qpos[bad] = self.qvel[bad] = np.nan

    def refuse_bad(self) -> None:
        counts = self._batch.warning[..., 1]  # (n, kinds)
        if not counts.any():
            return
        car, kind = (int(i) for i in np.argwhere(counts)[0])
        self._batch.warning[:] = 0
        raise RuntimeError(
            f"MuJoCo warned {mujoco.mjtWarning(kind).name} in environment {car}: its state or its "
            "parameters are outside the range of the physics; check the last pose and velocity"
        )
