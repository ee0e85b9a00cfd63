"""What every effect has in common: parameters, neutrality row by row, memory in the TensorDict.

An effect is physics that a simulator leaves out, as a transform between engine and task. Its
parameters may differ from car to car, so that a column of finite differences is a row of the
batch. Cars whose parameters are neutral are not touched at all: only the others are gathered,
computed and put back, so that dozens of effects can be stacked of which each car feels one.
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

from buggy_rl.keys import MEMORY
from buggy_rl.parameters import Parameter
from buggy_rl.vehicle import CONTROL_PERIOD

Number = TypeVar("Number", float, Tensor)


@dataclass(frozen=True)
class EffectParameter(Parameter):
    """One number of an effect; `value` is the neutral one, at which nothing is changed."""

    size: float
    """What is typical where this is the fault: one standard deviation of the prior. The distance
    from neutral, in the parameter's unit; for a reciprocal parameter the value itself."""
    probe: float
    """Step from neutral for a finite difference."""
    reciprocal: bool = False
    """The fault is 1 / value: neutral is so far away that it is never reached."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.size > 0:
            raise ValueError(f"parameter {self.name!r}: size {self.size} must be above 0")
        if self.probe == 0 or not self.lower <= self.value + self.probe <= self.upper:
            raise ValueError(
                f"parameter {self.name!r}: a probe of {self.probe} {self.unit} leads nowhere or "
                f"out of [{self.lower}, {self.upper}]"
            )

    def coordinate(self, value: Number) -> Number:
        """The value in units of `size`: 0 is neutral, 1 a typical fault."""
        if self.reciprocal:
            return self.size / value - self.size / self.value
        return (value - self.value) / self.size

    def value_at(self, coordinate: Number) -> Number:
        """The inverse of `coordinate`."""
        if self.reciprocal:
            return self.size / (coordinate + self.size / self.value)
        return self.value + self.size * coordinate


class Effect(Transform):
    """Missing physics with a name, an equation and parameters.

    Args:
        dt: Control period [s].
        values: Parameters that are not neutral, by name.

    Raises:
        ValueError: A name is not a parameter of the effect, or a value is outside its bounds.
    """

    name: ClassVar[str]
    kind: ClassVar[Literal["actuation", "motion", "sensing"]]
    equation: ClassVar[str]
    source: ClassVar[str] = ""
    """Where the equation is from, where that is known."""
    declared: ClassVar[tuple[EffectParameter, ...]]  # type: ignore[assignment]
    deciding: ClassVar[tuple[str, ...]] = ()
    """Parameters that make it neutral whatever the others are; none where all have to agree."""

    alternatives: ClassVar[tuple[str, ...]] = ()
    """Parameters that are another reading of the same physics: a fit leaves them neutral."""

    active: bool
    """Whether any car feels it."""

    def __init__(self, *, dt: float = CONTROL_PERIOD, **values: float) -> None:
        super().__init__()
        self.dt = dt
        self._refuse_unknown(values)
        chosen = {p.name: self._sensible(p, values.get(p.name, p.value)) for p in self.declared}
        self._adopt({name: torch.tensor(value) for name, value in chosen.items()})

    @classmethod
    @abstractmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        """The effect in plain words, numbers in everyday units."""

    @property
    def values(self) -> dict[str, Tensor]:
        """Parameter values in use, each of shape () or of the batch's shape."""
        return {p.name: self._kept("value_" + p.name) for p in self.declared}

    @property
    def options(self) -> dict[str, Any]:
        """Arguments of the constructor beside the parameters, those that differ from its own."""
        return {} if self.dt == CONTROL_PERIOD else {"dt": self.dt}

    def with_parameters(self, values: TensorDictBase) -> Self:
        """The same effect, in no environment, with other values, one set a car.

        Values are taken as they are: a fit may step out of the bounds.

        Args:
            values: Parameter name -> value of the batch's shape. Parameters that are not named
                keep their value.

        Raises:
            ValueError: A name is not a parameter of the effect.
        """
        self._refuse_unknown(values.keys())
        effect = self.clone()
        given = {name: value.to(torch.float32) for name, value in values.items()}
        effect._adopt({**self.values, **given})
        return effect

    def unsensed(self, pose: Tensor, velocity: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        """Best estimate of the motion that a measured record shows; the same, if not a sensing one.

        Args:
            pose: [*, T, 3] measured, yaw not wrapped.
            velocity: [*, T, 3] measured.
            dt: Time between rows [s].

        Returns:
            Both as they really were, same shapes.
        """
        return pose, velocity

    def _adopt(self, values: Mapping[str, Tensor]) -> None:
        """Takes values, and finds out which cars feel anything."""
        shape = torch.broadcast_shapes(*(value.shape for value in values.values()))
        felt = self._felt(values).expand(shape)
        cars = None
        if felt.device.type == "meta":  # what has no content may not be neutral
            self.active = True
        else:
            self.active = bool(felt.any())
            if self.active and not bool(felt.all()):
                cars = felt.reshape(-1).nonzero().squeeze(-1)
        self._batch = shape
        self.register_buffer("cars", cars, persistent=False)
        for name, value in values.items():
            self.register_buffer("value_" + name, value, persistent=False)
            here = value if cars is None or not value.dim() else value.reshape(-1)[cars]
            self.register_buffer("here_" + name, here, persistent=False)
        self._values_changed()

    def _felt(self, values: Mapping[str, Tensor]) -> Tensor:
        differs = [
            values[p.name] != torch.tensor(p.value, device=values[p.name].device)
            for p in self.declared
            if p.name in (self.deciding or values)
        ]
        felt = differs[0]
        for other in differs[1:]:
            felt = felt | other
        return felt

    def _values_changed(self) -> None:
        """Called after values were taken, for effects that keep something derived."""

    def _here(self, name: str) -> Tensor:
        """Values [n] of the cars that feel the effect, or () for one that all share."""
        return self._kept("here_" + name)

    def _keep(self, **derived: Tensor) -> None:
        """Keeps what was derived from the values, and moves with them to another device."""
        for name, value in derived.items():
            self.register_buffer(name, value, persistent=False)

    def _kept(self, name: str) -> Tensor:
        return self._buffers[name]  # type: ignore[return-value]

    def _take(self, tensor: Tensor, sizes: int = 1) -> Tensor:
        """The cars that feel the effect [n, ...] of a tensor [*batch, ...] of so many sizes."""
        cars = self._buffers["cars"]
        if cars is None:
            return tensor
        return tensor.reshape(-1, *tensor.shape[tensor.dim() - sizes :]).index_select(0, cars)

    def _put(self, tensor: Tensor, part: Tensor, sizes: int = 1) -> Tensor:
        """A copy of `tensor` in which the cars that feel the effect are replaced by `part`."""
        cars = self._buffers["cars"]
        if cars is None:
            return part
        flat = tensor.reshape(-1, *tensor.shape[tensor.dim() - sizes :])
        return flat.index_copy(0, cars, part.to(tensor.dtype)).reshape(tensor.shape)

    @property
    def memory(self) -> str:
        """Key of the effect's own latent state."""
        return self.name + MEMORY

    def _state_specs(
        self, shape: torch.Size, device: DEVICE_TYPING | None
    ) -> dict[str, TensorSpec]:
        """Specs of what the effect carries from step to step; none by default."""
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
                f"effect {self.name!r} has values for cars of shape {list(self._batch)}, the "
                f"environment has {list(shape)}: give with_parameters a TensorDict of that shape"
            )
        if self.active:
            state = self._state_specs(shape, device)
            twice = sorted(set(state) & set(observation_spec.keys()))
            if twice:
                raise ValueError(
                    f"effect {self.name!r} stands twice in the stack ({', '.join(twice)} is "
                    "already there): put both into one"
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
    def _sensible(cls, parameter: EffectParameter, value: float) -> float:
        if isinstance(value, bool) or not isinstance(value, numbers.Real):
            raise ValueError(f"effect {cls.name!r}: {parameter.name} is {value!r}, not a number")
        if not parameter.lower <= value <= parameter.upper:
            raise ValueError(
                f"effect {cls.name!r}: {parameter.name} is {value} {parameter.unit}, outside what "
                f"makes sense, [{parameter.lower}, {parameter.upper}]; neutral is {parameter.value}"
            )
        return float(value)


def numbers_spec(shape: torch.Size, *sizes: int, device: DEVICE_TYPING | None) -> Unbounded:
    """Spec of float32 numbers [*shape, *sizes]."""
    return Unbounded(torch.Size((*shape, *sizes)), device=device)


def one_in(value: float) -> str:
    """A ratio in words: 7 % more, 20 % less."""
    percent = abs(value - 1) * 100
    return f"{percent:.3g} % {'more' if value >= 1 else 'less'}"
