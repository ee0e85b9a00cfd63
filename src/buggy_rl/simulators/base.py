"""What every engine has in common: keys, specs, resets and declared parameters.

An engine moves the car and knows no task. Its whole state is in the TensorDict, so that a step is a
function of its input: an edit of `pose` or `velocity` between two steps takes effect, and two steps
from one TensorDict are equal.
"""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Self

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, TensorSpec, Unbounded

from buggy_rl.core import keys
from buggy_rl.core.parameters import Parameter, Realisations
from buggy_rl.core.vehicle import CONTROL_PERIOD, Similarity, VehicleDimensions, integrate_pose
from buggy_rl.simulators.resets import ResettableEnv, held, spread

FLOAT = torch.float32  # of what engines share with others, whatever PyTorch's default is


class Engine(ResettableEnv):
    """One kind of physics as a TorchRL environment.

    A subclass says what latent state it has (`_latent_specs`), its value after a reset
    (`_rest_latent`), and how one control period passes (`_advance`).

    Args:
        batch_size: Number of environments, or a shape; () for one without a batch dimension.
        device: Where the state lives.
        parameters: Values that differ from the declared ones, by name.
        dt: Control period [s].
        declared: Every parameter the engine has.
        ranges: Lower and upper bounds that differ from the declared ones, by name.

    Raises:
        KeyError: A parameter is unknown.
        ValueError: A value is outside its range, a range is not two numbers in order, or
            `batch_size` is 0.
    """

    batch_locked = True  # type: ignore[assignment]  # TorchRL: a property it lets subclasses set
    declared: dict[str, Parameter]
    """Physical parameters by name, with the values in use where all environments share them."""
    values: dict[str, Tensor]
    """Parameter values in use, each of shape () or of the batch's shape."""
    reach: float = 1.0
    """Largest size of a command to which its laws go on; only effects ask for more than 1."""
    lost_as_nan: bool = False
    """Whether a car whose physics breaks down has a state of NaN from then on, as a diagnosis wants
    of the numbers that it tries; else an engine that notices raises."""
    resets_alone: bool = False
    """Whether `_rest_latent` takes any number of cars where parameters are shared, and not only the
    whole batch: a reset of some environments then computes these alone."""

    def __init__(
        self,
        batch_size: int | Sequence[int] = (),
        device: torch.device | str = "cpu",
        parameters: Mapping[str, float] | None = None,
        dt: float = CONTROL_PERIOD,
        declared: Sequence[Parameter] = (),
        ranges: Mapping[str, Sequence[float]] | None = None,
    ) -> None:
        shape = (batch_size,) if isinstance(batch_size, int) else tuple(batch_size)
        if 0 in shape:
            raise ValueError(f"batch_size is {batch_size}: at least one environment is needed")
        super().__init__(device=torch.device(device), batch_size=torch.Size(shape))
        self.dt = dt
        self.declared = {p.name: p for p in declared}
        values, self._ranges = dict(parameters or {}), dict(ranges or {})
        self._refuse_unknown([*values, *self._ranges])
        self.declared = with_ranges(self.declared, self._ranges, values)
        self.values = {
            name: torch.tensor(p.value, dtype=torch.float32, device=self.device)
            for name, p in self.declared.items()
        }

    def _finish(self) -> None:
        """Builds the specs; a subclass calls it once it knows its latent state."""
        batch, device = self.batch_size, self.device
        state: dict[str, TensorSpec] = {
            keys.POSE: Unbounded(self._shape(3), device=device, dtype=FLOAT),
            keys.VELOCITY: Unbounded(self._shape(3), device=device, dtype=FLOAT),
            **self._latent_specs(),
        }
        self._kept, self._readings = state, self._reading_specs()
        self.state_spec = Composite(state, shape=batch, device=device)
        self.observation_spec = Composite({**state, **self._readings}, shape=batch, device=device)
        self.action_spec = Bounded(-1.0, 1.0, self._shape(2), device=device, dtype=FLOAT)
        self.reward_spec = Unbounded(self._shape(1), device=device, dtype=FLOAT)
        flag = Binary(1, shape=self._shape(1), dtype=torch.bool, device=device)
        self.full_done_spec = Composite(
            {keys.DONE: flag, keys.TERMINATED: flag.clone()}, shape=batch, device=device
        )

    def _shape(self, *sizes: int) -> torch.Size:
        """Shape of a value [sizes] of each environment."""
        return torch.Size((*self.batch_size, *sizes))

    def _latent_specs(self) -> dict[str, TensorSpec]:
        """Specs of the engine's latent state, full shape with the batch; none by default."""
        return {}

    def _number_specs(
        self, shapes: Mapping[str, tuple[int, ...]], dtype: torch.dtype = torch.float32
    ) -> dict[str, TensorSpec]:
        """Specs of unbounded numbers of these shapes behind the batch."""
        return {
            name: Unbounded(self._shape(*shape), device=self.device, dtype=dtype)
            for name, shape in shapes.items()
        }

    def _reading_specs(self) -> dict[str, TensorSpec]:
        """Specs of what a step reports beside its state; none by default."""
        return {}

    @abstractmethod
    def _rest_latent(self, pose: Tensor, velocity: Tensor) -> dict[str, Tensor]:
        """Estimate of the latent state of a car at `pose` [*, 3] with `velocity` [*, 3]."""

    @abstractmethod
    def _advance(self, state: TensorDictBase, action: Tensor) -> dict[str, Tensor]:
        """State and readings one control period later; `action` [*, 2] is within its bounds."""

    def _begin(self, given: TensorDictBase, rows: Tensor | None) -> TensorDictBase:
        shape = self.batch_size if rows is None else rows.shape
        known = {
            key: self._checked(key, value, spec, shape)
            for key, spec in self._kept.items()
            if (value := given.get(key, None)) is not None
        }
        zero = torch.zeros((*shape, 3), device=self.device, dtype=FLOAT)
        pose, velocity = (known.pop(key, zero).clone() for key in (keys.POSE, keys.VELOCITY))
        state = {keys.POSE: pose, keys.VELOCITY: velocity}
        if not known or len(known) < len(self._kept) - 2:
            state |= self._rest(pose, velocity, rows)
        for key, spec in self._readings.items():
            state[key] = torch.zeros(
                (*shape, *self._sizes(spec)), dtype=spec.dtype, device=self.device
            )
        over = torch.zeros((*shape, 1), dtype=torch.bool, device=self.device)
        ends = {keys.DONE: over, keys.TERMINATED: over.clone()}
        return TensorDict(state | known | ends, batch_size=shape, device=self.device)

    def _sizes(self, spec: TensorSpec) -> torch.Size:
        """Shape of a spec's value behind the batch."""
        return spec.shape[len(self.batch_size) :]

    def _checked(self, key: str, given: Tensor, spec: TensorSpec, shape: torch.Size) -> Tensor:
        """A copy of a value that a reset is to begin at.

        Raises:
            ValueError: It has another shape than the engine's own.
        """
        expected = torch.Size((*shape, *self._sizes(spec)))
        if given.shape != expected:
            raise ValueError(
                f"reset got {key} of shape {list(given.shape)}, expected {list(expected)}"
            )
        return given.to(device=self.device, dtype=spec.dtype, copy=True)

    def _rest(self, pose: Tensor, velocity: Tensor, rows: Tensor | None) -> dict[str, Tensor]:
        """Latent state of all environments, or [k, ...] of `rows` at `pose` [k, 3]."""
        if rows is None or (self.resets_alone and self._alike):
            return self._rest_latent(pose, velocity)
        motion = spread(TensorDict({"p": pose, "v": velocity}, rows.shape), rows, self.batch_size)
        latent = self._rest_latent(motion["p"], motion["v"])
        return {key: value.flatten(0, len(self.batch_size) - 1)[rows]
                for key, value in latent.items()}  # fmt: skip

    @property
    def _alike(self) -> bool:
        """Whether all environments have the same parameters."""
        return not any(value.dim() for value in self.values.values())

    def moved(self, state: Mapping[str, Tensor] | TensorDictBase) -> dict[str, Tensor]:
        """State and readings one control period after a state with its action."""
        action = state[keys.ACTION].to(FLOAT).clamp(-1.0, 1.0)
        beyond = state.get(keys.BEYOND, None)
        if beyond is not None:
            action = (action + beyond).clamp(-self.reach, self.reach)
        return self._advance(state, action)  # type: ignore[arg-type]

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        result = self.moved(tensordict)
        done = torch.zeros(self._shape(1), dtype=torch.bool, device=self.device)
        result[keys.REWARD] = torch.zeros(
            self._shape(1), device=self.device, dtype=FLOAT
        )  # the task's
        result[keys.DONE], result[keys.TERMINATED] = done, done.clone()
        after = TensorDict(result, batch_size=self.batch_size, device=self.device)
        return held(tensordict, after)

    def _set_seed(self, seed: int | None) -> None:
        """Engines are deterministic: noise belongs to the sensing, starts to the task."""

    def vehicle(self) -> VehicleDimensions:
        """The car by its parameters, mean over the batch."""
        own = self._named("mass", "yaw_inertia", "cg_to_front_axle")
        return replace(self._nominal(), **own)

    def _nominal(self) -> VehicleDimensions:
        """The car where no parameter says otherwise: the buggy."""
        return VehicleDimensions()

    @property
    def similarity(self) -> Similarity:
        """Ratios of the car to the buggy, which lengths and speeds are judged by."""
        return Similarity()

    def _named(self, *names: str) -> dict[str, float]:
        """Parameters by name, as far as the engine has them."""
        return {n: round(float(self.values[n].mean()), 6) for n in names if n in self.values}

    @property
    def realises(self) -> Realisations:
        """Effects that are exactly a change of declared parameters; none by default."""
        return {}

    @property
    def half_step(self) -> dict[str, Any]:
        """Arguments with which this engine integrates in half its step; none if it has no step."""
        return {}

    def _options(self) -> dict[str, Any]:
        """Arguments of the constructor beside those of `Engine`; none by default."""
        return {}

    def _rebuilt(self, batch_size: Sequence[int]) -> Self:
        """The same engine for another batch size."""
        values = {name: parameter.value for name, parameter in self.declared.items()}
        options: dict[str, Any] = self._options()
        if self._ranges:
            options = {**options, "ranges": self._ranges}
        return type(self)(batch_size, self.device, values, self.dt, **options)

    def with_parameters(self, values: TensorDictBase) -> Self:
        """The same engine with other parameter values, one set per environment.

        Args:
            values: Parameter name -> value of the batch's shape; its batch size becomes the
                engine's. Parameters that are not named keep their value.

        Raises:
            KeyError: A name is not a parameter of this engine.
        """
        self._refuse_unknown(values.keys())
        engine = self._rebuilt(values.batch_size)
        for name, value in self.values.items():
            engine.values[name] = value
        for name, value in values.items():
            engine.values[name] = value.to(device=self.device, dtype=torch.float32)
        engine._parameters_changed()
        return engine

    def _parameters_changed(self) -> None:
        """Called after `values` were replaced, for engines that keep something derived."""

    def to(self, device: torch.device | str | int) -> Self:
        """Moves the engine with its parameter values and what is derived of them."""
        before = self.device
        super().to(device)
        if self.device != before:
            self.values = {name: value.to(self.device) for name, value in self.values.items()}
            self._parameters_changed()
        return self

    def _refuse_unknown(self, names) -> None:
        unknown = sorted(set(names) - set(self.declared))
        if unknown:
            raise KeyError(
                f"{type(self).__name__} has no parameter {', '.join(unknown)}; "
                f"available: {', '.join(sorted(self.declared)) or 'none'}"
            )


def with_ranges(
    declared: Mapping[str, Parameter],
    ranges: Mapping[str, Sequence[float]],
    values: Mapping[str, float] | None = None,
) -> dict[str, Parameter]:
    """Parameters with other ranges, and other values, by name.

    Raises:
        ValueError: A range is not two numbers in order, or a value is outside its range.
    """
    values, result = values or {}, dict(declared)
    for name in {*ranges, *values}:
        p = declared[name]
        ends = [float(end) for end in ranges.get(name, (p.lower, p.upper))]
        if len(ends) != 2 or not ends[0] < ends[1]:
            raise ValueError(f"ranges: {name} is {ends}: write [lower, upper], in {p.unit}")
        value = float(values.get(name, p.value))
        result[name] = replace(p, value=value, lower=ends[0], upper=ends[1])
    return result


class RowsEngine(Engine):
    """An engine whose environments are the rows of arrays, by default NumPy's, on the CPU."""

    def _array(self, tensor: Tensor) -> Any:
        """A tensor as the array that this engine computes with: float64, of NumPy."""
        return tensor.detach().to("cpu", torch.float64).numpy()

    def _rows(self, tensor: Tensor) -> Any:
        """A tensor [*batch, ...] as rows [n, ...]."""
        inner = tensor.shape[len(self.batch_size) :]
        return self._array(tensor.reshape(-1, *inner))

    def _tensor(self, rows: Any) -> Tensor:
        """Rows [n, ...] as a tensor [*batch, ...]."""
        return torch.as_tensor(rows).reshape(self._shape(*rows.shape[1:])).to(self.device)


class HoldEngine(Engine):
    """Velocity stays, pose follows: v' = v."""

    resets_alone = True

    def __init__(self, *args, **kwargs) -> None:
        super().__init__(*args, **kwargs)
        self._finish()

    def _rest_latent(self, pose: Tensor, velocity: Tensor) -> dict[str, Tensor]:
        return {}

    def _advance(self, state: TensorDictBase, action: Tensor) -> dict[str, Tensor]:
        velocity = state[keys.VELOCITY]
        pose = integrate_pose(state[keys.POSE], velocity, velocity, self.dt)
        return {keys.POSE: pose, keys.VELOCITY: velocity.clone()}
