"""A user's single environment as a batch, and in single precision."""

from collections.abc import Sequence
from typing import Any, Self

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, TensorSpec
from torchrl.envs import EnvBase

from buggy_rl.core import keys
from buggy_rl.simulators.resets import STEP, ResettableEnv, begun, held


class SerialBatch(ResettableEnv):
    """One environment after the other, all by the same instance.

    A simulator's whole state rides in the TensorDict, so that one instance can step every
    environment, where TorchRL's `SerialEnv` keeps as many instances and a state in each. What it
    declares is not passed on: its parameters hold for one environment.

    Args:
        simulator: Of the contract, with batch size [] or [1].
        count: Environments.
    """

    batch_locked = True  # type: ignore[assignment]  # TorchRL: a property it lets subclasses set
    one_at_a_time = True
    simulator: EnvBase

    def __init__(self, simulator: EnvBase, count: int) -> None:
        super().__init__(device=simulator.device, batch_size=torch.Size([count]))
        self.simulator = simulator
        self._single = simulator.batch_size == torch.Size([])
        self.full_observation_spec = self._many(simulator.full_observation_spec)
        self.full_state_spec = self._many(simulator.full_state_spec)
        self.full_action_spec = self._many(simulator.full_action_spec)
        self.full_reward_spec = self._many(simulator.full_reward_spec)
        self.full_done_spec = self._many(simulator.full_done_spec)
        period: Any = getattr(simulator, "dt", None)
        if period is not None:
            self.dt = float(period)

    def _many(self, spec: Any) -> Any:
        one = spec if self._single else spec[0]
        return one.expand(*self.batch_size)

    def _begin(self, given: TensorDictBase, rows: Tensor | None) -> TensorDictBase:
        return self._joined([self._begun(self._row(given, row)) for row in range(len(given))])

    def _begun(self, given: TensorDictBase) -> TensorDictBase:
        return begun(self.simulator, given, None)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        state = tensordict.exclude(STEP)
        rows = range(self.batch_size[0])
        after = self._joined([self.simulator._step(self._row(state, row)) for row in rows])
        return held(tensordict, after)

    def _row(self, tensordict: TensorDictBase, row: int) -> TensorDictBase:
        return (tensordict[row] if self._single else tensordict[row : row + 1]).clone()

    def _joined(self, rows: list[TensorDictBase]) -> TensorDictBase:
        join: Any = torch.stack if self._single else torch.cat
        return join(rows)

    def _set_seed(self, seed: int | None) -> None:
        self.simulator.set_seed(seed)

    def to(self, device: torch.device | str | int) -> Self:
        """Moves the simulator too."""
        self.simulator.to(device)
        super().to(device)
        return self


def in_batch(simulator: EnvBase, batch_size: int | Sequence[int]) -> EnvBase:
    """A simulator of that many environments: itself, or `SerialBatch` of one that has only one."""
    asked = torch.Size([batch_size] if isinstance(batch_size, int) else batch_size)
    if not isinstance(simulator, EnvBase) or len(asked) != 1 or simulator.batch_size == asked:
        return simulator
    if simulator.batch_size not in (torch.Size([]), torch.Size([1])):
        return simulator
    return SerialBatch(simulator, asked[0])


SHARED = (keys.POSE, keys.VELOCITY, keys.ACTION, keys.REWARD)  # what others read and write


class SinglePrecision(ResettableEnv):
    """Pose, velocity, action and reward in float32; the simulator computes in its own type.

    Its latent state keeps its type. An environment, not a transform, so that a simulator stays an
    engine over which effects stand. Everything else it has (`declared`, `dt`, ...) is the wrapped
    one's.

    Args:
        simulator: Of the contract, with `pose` or another shared key in float64.
    """

    batch_locked = True  # type: ignore[assignment]  # TorchRL: a property it lets subclasses set
    simulator: EnvBase

    def __init__(self, simulator: EnvBase) -> None:
        super().__init__(device=simulator.device, batch_size=simulator.batch_size)
        self.simulator = simulator
        state, action = simulator.full_state_spec, simulator.full_action_spec
        self._own_types = {
            key: spec.dtype
            for specs in (simulator.full_observation_spec, state, action)
            for key, spec in specs.items()
            if key in SHARED
        }
        self.full_observation_spec = _single(simulator.full_observation_spec)
        self.full_state_spec = _single(state)
        self.full_action_spec = _single(action)
        self.full_reward_spec = _single(simulator.full_reward_spec)
        self.full_done_spec = simulator.full_done_spec.clone()

    def _begin(self, given: TensorDictBase, rows: Tensor | None) -> TensorDictBase:
        return _narrowed(begun(self.simulator, self._own(given), rows))

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        after = _narrowed(self.simulator._step(self._own(tensordict.exclude(STEP))))
        return held(tensordict, after)

    def _set_seed(self, seed: int | None) -> None:
        self.simulator.set_seed(seed)

    def to(self, device: torch.device | str | int) -> Self:
        """Moves the simulator too."""
        self.simulator.to(device)
        super().to(device)
        return self

    def _own(self, tensordict: TensorDictBase) -> TensorDictBase:
        """A shallow copy with the shared numbers in the simulator's types."""
        result = tensordict.copy()
        for key, dtype in self._own_types.items():
            value = tensordict.get(key, None)
            if value is not None:
                result.set(key, value.to(dtype))
        return result

    def __getattr__(self, name: str) -> Any:
        try:
            return super().__getattr__(name)
        except AttributeError:
            value = getattr(super().__getattr__("simulator"), name)
        if name == "with_parameters":
            return lambda values: in_single_precision(value(values))
        return value


def in_single_precision(simulator: EnvBase) -> EnvBase:
    """A simulator whose shared numbers are float32: itself, or `SinglePrecision` of it."""
    specs = (
        simulator.full_observation_spec,
        simulator.full_action_spec,
        simulator.full_reward_spec,
    )
    types = {spec.dtype for part in specs for key, spec in part.items() if key in SHARED}
    return simulator if types <= {torch.float32} else SinglePrecision(simulator)


def _single(specs: Composite) -> Composite:
    result = specs.clone()
    for key in SHARED:
        spec: TensorSpec | None = result.get(key, None)
        if spec is not None:
            result[key] = spec.to(torch.float32)
    return result


def _narrowed(tensordict: TensorDictBase) -> TensorDictBase:
    for key in SHARED:
        value = tensordict.get(key, None)
        if value is not None:
            tensordict.set(key, value.to(torch.float32))
    return tensordict
