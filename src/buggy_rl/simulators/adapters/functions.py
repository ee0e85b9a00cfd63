"""A simulator of two functions: what is at rest, and what is one control period later."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec, Unbounded
from torchrl.envs import EnvBase

from buggy_rl.core import keys
from buggy_rl.core.longitudinal import LongitudinalCommand
from buggy_rl.core.parameters import Parameter
from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.simulators.base import RowsEngine

State = Mapping[str, Any]
"""`pose` [3], `velocity` [3] and latent state by name, of one car or [n, ...] of a batch."""
Factory = Callable[[int, str], EnvBase]
"""What builds a simulator for a batch size on a device."""
MOTION = {keys.POSE: 3, keys.VELOCITY: 3}


class FunctionsEngine(RowsEngine):
    """x' = step(x, u): a user's functions as an engine; see `from_step`."""

    resets_alone = True
    vehicle: Any = None  # of this car nothing is known: a diagnosis measures it

    def __init__(
        self,
        *args: Any,
        step: Callable[..., State],
        reset: Callable[..., State] | None = None,
        batched: bool = False,
        declared: Sequence[Parameter] = (),
        command: str | Mapping[str, Any] | LongitudinalCommand = "throttle",
        **common: Any,
    ) -> None:
        super().__init__(*args, declared=declared, **common)
        self.step_function, self.reset_function, self.batched = step, reset, batched
        self.command = LongitudinalCommand.of(command)
        self.one_at_a_time = not batched
        zero = np.zeros((1, 3))
        found = self._reset_rows(zero, zero)
        self._latent = {name: row[0] for name, row in found.items() if name not in MOTION}
        self._finish()

    def _latent_specs(self) -> dict[str, TensorSpec]:
        shapes = {name: torch.as_tensor(row) for name, row in self._latent.items()}
        return {
            name: Unbounded(self._shape(*row.shape), device=self.device, dtype=row.dtype)
            for name, row in shapes.items()
        }

    def _rest_latent(self, pose: Tensor, velocity: Tensor) -> dict[str, Tensor]:
        motion = (self._array(part.reshape(-1, 3)) for part in (pose, velocity))
        return self._tensors(self._reset_rows(*motion), pose.shape[:-1])

    @property
    def _alike(self) -> bool:
        return True  # as far as a reset goes: it is given no parameter

    def _advance(self, state: TensorDictBase, action: Tensor) -> dict[str, Tensor]:
        before: dict[str, Any] = {name: self._rows(state[name]) for name in MOTION}
        for name in self._latent:  # in its own type
            value = state[name].reshape(-1, *state[name].shape[len(self.batch_size) :])
            before[name] = value.cpu().numpy()
        values = {n: np.broadcast_to(self._rows(v), len(before[keys.POSE]))
                  for n, v in self._of_rows().items()}  # fmt: skip
        after = self._called(self.step_function, before, self._rows(action), values, "step")
        self._refuse_other(after, {*MOTION, *self._latent}, "step")
        return self._tensors(after, self.batch_size)

    def _of_rows(self) -> dict[str, Tensor]:
        """Parameter values, of the batch's shape."""
        return {name: value.expand(self.batch_size) for name, value in self.values.items()}

    def _reset_rows(self, pose: NDArray, velocity: NDArray) -> dict[str, NDArray]:
        """Whole state [n, ...] of cars at these poses and velocities."""
        motion = {keys.POSE: pose, keys.VELOCITY: velocity}
        if self.reset_function is None:
            return motion
        if self.batched:
            return motion | self._arrays(self.reset_function(pose.copy(), velocity.copy()), "reset")
        rows = [
            self._arrays(self.reset_function(p.copy(), v.copy()), "reset")
            for p, v in zip(pose, velocity, strict=True)
        ]
        return motion | {name: np.stack([row[name] for row in rows]) for name in rows[0]}

    def _called(
        self,
        function: Callable[..., State],
        state: dict[str, NDArray],
        action: NDArray,
        values: dict[str, NDArray],
        what: str,
    ) -> dict[str, NDArray]:
        """What the user's function makes of rows: at once, or of one car after the other."""
        more = (values,) if values else ()
        if self.batched:
            given = {name: rows.copy() for name, rows in state.items()}
            return self._arrays(function(given, action.copy(), *more), what)
        results = []
        for row in range(len(action)):
            given = {name: _item(rows[row]) for name, rows in state.items()}
            own = ({name: float(value[row]) for name, value in values.items()},) if values else ()
            results.append(self._arrays(function(given, action[row].copy(), *own), what))
        return {name: np.stack([result[name] for result in results]) for name in results[0]}

    def _arrays(self, state: Any, what: str) -> dict[str, NDArray]:
        """A state that a function returned, as arrays.

        Raises:
            ValueError: It is no mapping, or pose or velocity has another shape.
        """
        if not isinstance(state, Mapping):
            raise ValueError(
                f"{what} returned a {type(state).__name__}: it must return a dict with "
                "'pose', 'velocity' and what else the car remembers"
            )
        arrays = {str(name): np.asarray(value) for name, value in state.items()}
        odd = [name for name, value in arrays.items() if value.dtype.kind not in "biuf"]
        if odd:
            raise ValueError(f"{what} returned {', '.join(odd)} that are no numbers: return arrays")
        for name, size in MOTION.items():
            if name in arrays and arrays[name].shape[-1:] != (size,):
                raise ValueError(
                    f"{what} returned {name!r} of shape {list(arrays[name].shape)}: must be "
                    f"{'[n, 3]' if self.batched else '[3]'}"
                )
        return arrays

    def _refuse_other(self, state: Mapping[str, Any], expected: set[str], what: str) -> None:
        lacking, odd = sorted(expected - set(state)), sorted(set(state) - expected)
        if lacking:
            raise ValueError(
                f"{what} returned no {', '.join(map(repr, lacking))}: return every key of the "
                f"state that it is given ({', '.join(sorted(expected))})"
            )
        if odd:
            raise ValueError(
                f"{what} returned {', '.join(map(repr, odd))}, which reset does not return: "
                "return what the car remembers from both, or from neither"
            )

    def _tensors(self, rows: Mapping[str, NDArray], shape: torch.Size) -> dict[str, Tensor]:
        result = {}
        for name, value in rows.items():
            kind = np.float32 if name in MOTION else self._latent[name].dtype
            tensor = torch.as_tensor(np.ascontiguousarray(value, kind))
            result[name] = tensor.reshape((*shape, *value.shape[1:])).to(self.device)
        return result

    def _options(self) -> dict[str, Any]:
        return {
            "step": self.step_function,
            "reset": self.reset_function,
            "batched": self.batched,
            "declared": tuple(self.declared.values()),
            "command": self.command,
        }


def _item(value: NDArray) -> Any:
    """A row of the state as a user's function has it: a number where it is one."""
    return value.copy() if value.ndim else value.item()


def from_step(
    reset: Callable[..., State] | None,
    step: Callable[..., State],
    *,
    parameters: Sequence[Parameter] = (),
    batched: bool = False,
    dt: float = CONTROL_PERIOD,
    command: str | Mapping[str, Any] = "throttle",
) -> Factory:
    """A simulator from the function of its step.

    A state is a dict of `pose` (x, y, yaw; world frame, m and rad), `velocity` (vx, vy, yaw_rate;
    body frame) and whatever else the car remembers, by names of your own, as NumPy arrays or
    numbers. `step` begins with the pose and velocity that it is given, since others edit them, and
    keeps nothing between calls.

        make = from_step(reset, step)          # my_car.py
        python scripts/diagnose.py simulator=my_car.py:make ...

    Args:
        reset: pose [3], velocity [3] -> state, the best guess of what is not known; None where pose
            and velocity are the whole state.
        step: state, action [2] (throttle, steering in [-1, 1]) -> state one control period later;
            with `parameters` it is given a dict of their values, too.
        parameters: That a fit or a diagnosis may change.
        batched: The functions take and return n cars at once, [n, 3] for [3]: many times faster.
        dt: Control period [s].
        command: Kind of the first command (docs/recordings.md): `throttle`: no reverse, -1 is no
            drive.

    Returns:
        factory(batch_size, device).
    """
    return partial(
        FunctionsEngine,
        step=step,
        reset=reset,
        batched=batched,
        declared=tuple(parameters),
        dt=dt,
        command=command,
    )
