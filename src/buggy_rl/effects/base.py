"""What every effect has in common: parameters, neutral rows of a batch, state in the TensorDict.

An effect is physics that a simulator lacks, as a TorchRL transform between engine and task.
Its parameters may differ between the environments of a batch, so that one rollout holds all finite
differences of a fit. Environments whose parameters are neutral are left as they are, to the last
bit: only the others are gathered, computed and scattered back, so dozens of effects can be stacked
of which each environment has one.
"""

import numbers
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Self, TypeVar

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, TensorSpec, Unbounded
from torchrl.data.utils import DEVICE_TYPING
from torchrl.envs import Transform

from buggy_rl.core import keys
from buggy_rl.core.keys import MEMORY
from buggy_rl.core.longitudinal import ONE_WAY, ONE_WAY_REST, LongitudinalCommand
from buggy_rl.core.parameters import Parameter
from buggy_rl.core.vehicle import CONTROL_PERIOD, VehicleDimensions

Number = TypeVar("Number", float, Tensor)


@dataclass(frozen=True)
class EffectParameter(Parameter):
    """One parameter of an effect; `value` is the neutral one, at which nothing is changed."""

    size: float
    """Prior scale: one standard deviation of the prior where this is the fault. A distance from
    neutral in the parameter's unit; for a reciprocal parameter a value."""
    probe: float
    """Step from neutral for a finite difference, in the parameter's unit."""
    reciprocal: bool = False
    """The prior is on 1 / value; neutral is so large that no limit is ever reached."""
    usual: tuple[float, float] | None = None
    """Interval in which 5 to 95 % of real small cars lie, in the parameter's unit; None where
    nothing is known. A fitted value beyond it is more probably another effect."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.size > 0:
            raise ValueError(f"parameter {self.name!r}: size {self.size} must be above 0")
        if self.probe == 0 or not self.lower <= self.value + self.probe <= self.upper:
            raise ValueError(
                f"parameter {self.name!r}: a probe of {self.probe} {self.unit} is zero or leads "
                f"out of [{self.lower}, {self.upper}]"
            )
        if self.usual is not None and not self.usual[0] <= self.value <= self.usual[1]:
            low, high = self.usual
            if not (self.reciprocal and low < high < self.value):  # a limit that most cars have
                raise ValueError(
                    f"parameter {self.name!r}: its usual interval [{low}, {high}] {self.unit} does "
                    f"not hold the neutral {self.value}"
                )

    def coordinate(self, value: Number) -> Number:
        """The normalised value: distance from neutral over the prior scale."""
        if self.reciprocal:
            return self.size / value - self.size / self.value
        return (value - self.value) / self.size

    def value_at(self, coordinate: Number) -> Number:
        """The inverse of `coordinate`."""
        if self.reciprocal:
            return self.size / (coordinate + self.size / self.value)
        return self.value + self.size * coordinate


def at_rows(tensor: Tensor, rows: Tensor | None, sizes: int = 1) -> Tensor:
    """Rows [n, ...] of a tensor [*batch, ...] with `sizes` dimensions behind the batch.

    All of it, in its own shape, where `rows` is None.
    """
    if rows is None:
        return tensor
    if tensor.dim() == 2 and sizes == 1:  # what nearly all are, in fewer calls
        return tensor.T.index_select(1, rows).T
    flat = tensor.reshape(-1, *tensor.shape[tensor.dim() - sizes :])
    return flat.movedim(0, -1).index_select(-1, rows).movedim(-1, 0)


def with_rows(tensor: Tensor, rows: Tensor | None, part: Tensor, sizes: int = 1) -> Tensor:
    """A copy of `tensor` with its rows replaced by `part`; inverse of `at_rows`."""
    if rows is None:
        return part
    if tensor.dim() == 2 and sizes == 1:
        return tensor.T.index_copy(1, rows, part.to(tensor.dtype).T).T
    flat = tensor.reshape(-1, *tensor.shape[tensor.dim() - sizes :])
    last, part = flat.movedim(0, -1), part.to(tensor.dtype).movedim(0, -1)
    return last.index_copy(-1, rows, part).movedim(-1, 0).reshape(tensor.shape)


class Effect(Transform):
    """Missing physics with a name, an equation, a source and parameters.

    Args:
        dt: Control period [s].
        values: Parameters that are not neutral and options, by name.

    Raises:
        ValueError: A name is neither a parameter nor an option of the effect, or a value is outside
            its bounds.
    """

    name: ClassVar[str]
    kind: ClassVar[Literal["actuation", "motion", "sensing"]]
    equation: ClassVar[str]
    source: ClassVar[str]
    """Textbook or paper of the equation: author, year, chapter or equation."""
    look_at: ClassVar[str] = ""
    """What to check on the car where this is found, in a sentence; optional."""
    may_delay: ClassVar[bool] = True
    """Whether a fit without it may take its delay for an offset of the clock."""
    declared: ClassVar[tuple[EffectParameter, ...]]  # type: ignore[assignment]
    deciding: ClassVar[tuple[str, ...]] = ()
    """Parameters each of which makes the effect neutral by itself; empty: all must be neutral."""
    alternatives: ClassVar[tuple[str, ...]] = ()
    """Parameters that describe the same physics in another way: a fit leaves them neutral."""
    option_names: ClassVar[tuple[str, ...]] = ()
    """Properties of the simulator that the equation needs: numbers or pairs of numbers, whose
    defaults are the class attributes of the same names."""

    rest: float = ONE_WAY_REST
    """Throttle without drive of the simulator, an option of every effect: 0 with reverse."""

    active: bool
    """Whether a parameter of any environment is not neutral."""

    def __init__(self, *, dt: float = CONTROL_PERIOD, **values: Any) -> None:
        super().__init__()
        self.dt = dt
        for name in (*self.option_names, "rest"):
            if name in values:
                setattr(self, name, self._option(name, values.pop(name)))
        self._refuse_unknown(values)
        chosen = {p.name: self._checked(p, values.get(p.name, p.value)) for p in self.declared}
        self._set_values({name: torch.tensor(value) for name, value in chosen.items()})

    @classmethod
    @abstractmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        """The effect in plain words, numbers in everyday units."""

    @classmethod
    def sentence_for(cls, values: Mapping[str, float], command: LongitudinalCommand) -> str:
        """`sentence` in the words of a kind of command; the same where no effect says otherwise."""
        return cls.sentence(values)

    @property
    def values(self) -> dict[str, Tensor]:
        """Parameter values in use, each of shape () or of the batch's shape."""
        return {p.name: self._tensor("value_" + p.name) for p in self.declared}

    @property
    def options(self) -> dict[str, Any]:
        """Arguments of the constructor beside the parameters that differ from their defaults."""
        changed: dict[str, Any] = {} if self.dt == CONTROL_PERIOD else {"dt": self.dt}
        for name in (*self.option_names, "rest"):
            value = getattr(self, name)
            if value != getattr(type(self), name):
                changed[name] = list(value) if isinstance(value, tuple) else value
        return changed

    @classmethod
    def said(
        cls,
        values: Mapping[str, float],
        car: VehicleDimensions,
        command: LongitudinalCommand = ONE_WAY,
    ) -> str:
        """`sentence_for` a car of these dimensions, where the words need them."""
        del car
        return cls.sentence_for(values, command)

    def _option(self, name: str, value: Any) -> Any:
        """An option as a float or a pair of floats, like its default."""
        if isinstance(getattr(type(self), name), tuple):
            first, second = value
            return float(first), float(second)
        return float(value)

    def with_parameters(self, values: TensorDictBase) -> Self:
        """The same effect, in no environment, with other values, one set per environment.

        Values are not checked against the bounds: a fit may step out of them.

        Args:
            values: Parameter name -> value of the batch's shape. Parameters that are not named
                keep their value.

        Raises:
            ValueError: A name is not a parameter of the effect.
        """
        self._refuse_unknown(values.keys())
        effect = self.clone()
        given = {name: value.to(torch.float32) for name, value in values.items()}
        effect._set_values({**self.values, **given})
        return effect

    def unsensed(self, pose: Tensor, velocity: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        """Estimates the true motion from a measured one; the same unless the effect is a sensor's.

        Args:
            pose: [*, T, 3] measured, yaw not wrapped.
            velocity: [*, T, 3] measured.
            dt: Time between rows [s].

        Returns:
            True pose and velocity, same shapes.
        """
        return pose, velocity

    def rows_late(self, dt: float) -> Tensor:
        """Rows [*] after which a motion is measured; none unless the effect is a slow sensor's."""
        return torch.zeros((), dtype=torch.long)

    def _set_values(self, values: Mapping[str, Tensor]) -> None:
        """Takes values and finds the rows of the flattened batch in which one is not neutral."""
        shape = torch.broadcast_shapes(*(value.shape for value in values.values()))
        changed = self._not_neutral(values).expand(shape)
        rows = None
        if changed.device.type == "meta":  # without content any value may be other than neutral
            self.active = True
        else:
            self.active = bool(changed.any())
            if self.active and not bool(changed.all()):
                rows = changed.reshape(-1).nonzero().squeeze(-1)
        self._batch = shape
        self.register_buffer("active_rows", rows, persistent=False)
        for name, value in values.items():
            self.register_buffer("value_" + name, value, persistent=False)
            used = value if rows is None or not value.dim() else value.reshape(-1)[rows]
            self.register_buffer("active_value_" + name, used, persistent=False)
        self._values_changed()

    def _not_neutral(self, values: Mapping[str, Tensor]) -> Tensor:
        differs = [
            values[p.name] != torch.tensor(p.value, device=values[p.name].device)
            for p in self.declared
            if p.name in (self.deciding or values)
        ]
        result = differs[0]
        for other in differs[1:]:
            result = result | other
        return result

    def _values_changed(self) -> None:
        """Called after values were set, for effects that derive tensors from them."""

    def _value(self, name: str) -> Tensor:
        """Values [n] of a parameter in the active rows, or () for one that all rows share."""
        return self._tensor("active_value_" + name)

    def _store(self, **derived: Tensor) -> None:
        """Stores tensors that were derived from the values; they follow the effect's device."""
        for name, value in derived.items():
            self.register_buffer(name, value, persistent=False)

    def _tensor(self, name: str) -> Tensor:
        return self._buffers[name]  # type: ignore[return-value]

    @property
    def rows(self) -> Tensor | None:
        """Rows [n] of a flat batch in which it is active; None where it is in all."""
        return self._buffers["active_rows"]

    def _gather(self, tensor: Tensor, sizes: int = 1) -> Tensor:
        """Active rows [n, ...] of a tensor [*batch, ...]: `at_rows`."""
        return at_rows(tensor, self._buffers["active_rows"], sizes)

    def _scatter(self, tensor: Tensor, part: Tensor, sizes: int = 1) -> Tensor:
        """A copy of `tensor` with its active rows replaced by `part`: `with_rows`."""
        return with_rows(tensor, self._buffers["active_rows"], part, sizes)

    @property
    def resets_alone(self) -> bool:
        """Whether all environments share its values, so that some can be reset by themselves."""
        return not self._batch

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        if self.active:
            self._write_reset(tensordict, tensordict_reset)
            memory = tensordict.get(self.memory, None)  # of an episode that goes on
            if memory is not None:
                tensordict_reset.set(self.memory, memory)
        return tensordict_reset

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        if self.active:
            self._write_step(tensordict, next_tensordict)
        return next_tensordict

    def _write_reset(self, given: TensorDictBase, state: TensorDictBase) -> None:
        """Writes into `state`, as the engine reset it from `given`; nothing by default."""

    def _write_step(self, before: TensorDictBase, after: TensorDictBase) -> None:
        """Writes into `after`, the engine's state one step from `before`; nothing by default."""

    @property
    def memory(self) -> str:
        """Key of the effect's own latent state."""
        return self.name + MEMORY

    def _state_specs(
        self, shape: torch.Size, device: DEVICE_TYPING | None
    ) -> dict[str, TensorSpec]:
        """Specs of the effect's latent state; none by default."""
        return {}

    def _reading_specs(
        self, shape: torch.Size, device: DEVICE_TYPING | None
    ) -> dict[str, TensorSpec]:
        """Specs of what it writes beside that; none by default."""
        return {}

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        shape, device = observation_spec.shape, observation_spec.device
        if len(self._batch) and self._batch != shape:
            raise ValueError(
                f"effect {self.name!r} has values of batch shape {list(self._batch)}, the "
                f"environment has {list(shape)}: give with_parameters a TensorDict of that shape"
            )
        if self.active:
            state = self._state_specs(shape, device)
            twice = sorted(set(state) & set(observation_spec.keys()) - {keys.ELAPSED})
            if twice:
                raise ValueError(
                    f"effect {self.name!r} is in the stack twice (key {', '.join(twice)} is "
                    "already there): merge the two into one"
                )
            observation_spec.update({**state, **self._reading_specs(shape, device)})
        return observation_spec

    def transform_state_spec(self, state_spec: Composite) -> Composite:
        if self.active:
            for key, spec in self._state_specs(state_spec.shape, state_spec.device).items():
                state_spec[key] = spec
        return state_spec

    @classmethod
    def _refuse_unknown(cls, names) -> None:
        known = [p.name for p in cls.declared]
        unknown = sorted(set(names) - set(known))
        if unknown:
            raise ValueError(
                f"effect {cls.name!r} has no parameter {', '.join(unknown)}; "
                f"available: {', '.join(known)}"
            )

    @classmethod
    def _checked(cls, parameter: EffectParameter, value: float) -> float:
        if isinstance(value, bool) or not isinstance(value, numbers.Real):
            raise ValueError(f"effect {cls.name!r}: {parameter.name} is {value!r}, not a number")
        if not parameter.lower <= value <= parameter.upper:
            raise ValueError(
                f"effect {cls.name!r}: {parameter.name} is {value} {parameter.unit}, outside its "
                f"range [{parameter.lower}, {parameter.upper}]; neutral is {parameter.value}"
            )
        return float(value)


def numbers_spec(shape: torch.Size, *sizes: int, device: DEVICE_TYPING | None) -> Unbounded:
    """Spec of float32 numbers [*shape, *sizes]."""
    return Unbounded(torch.Size((*shape, *sizes)), device=device)


def more_or_less(ratio: float) -> str:
    """A ratio in words: 7 % more, 20 % less."""
    percent = abs(ratio - 1) * 100
    return f"{percent:.3g} % {'more' if ratio >= 1 else 'less'}"
