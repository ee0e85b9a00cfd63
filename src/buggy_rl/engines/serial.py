"""A user's own simulator of a single environment, as a batch."""

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.envs import EnvBase


class SerialBatch(EnvBase):
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

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        rows = range(self.batch_size[0])
        given = [None if tensordict is None else self._row(tensordict, row) for row in rows]
        return self._joined([self.simulator._reset(one, **kwargs) for one in given])

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        rows = range(self.batch_size[0])
        return self._joined([self.simulator._step(self._row(tensordict, row)) for row in rows])

    def _row(self, tensordict: TensorDictBase, row: int) -> TensorDictBase:
        return (tensordict[row] if self._single else tensordict[row : row + 1]).clone()

    def _joined(self, rows: list[TensorDictBase]) -> TensorDictBase:
        join: Any = torch.stack if self._single else torch.cat
        return join(rows)

    def _set_seed(self, seed: int | None) -> None:
        self.simulator.set_seed(seed)


def in_batch(simulator: EnvBase, batch_size: int | Sequence[int]) -> EnvBase:
    """A simulator of that many environments: itself, or `SerialBatch` of one that has only one."""
    asked = torch.Size([batch_size] if isinstance(batch_size, int) else batch_size)
    if not isinstance(simulator, EnvBase) or len(asked) != 1 or simulator.batch_size == asked:
        return simulator
    if simulator.batch_size not in (torch.Size([]), torch.Size([1])):
        return simulator
    return SerialBatch(simulator, asked[0])
