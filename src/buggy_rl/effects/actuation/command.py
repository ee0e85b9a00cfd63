"""What effects on a command have in common: one channel, and what it was told before."""

from abc import abstractmethod
from typing import ClassVar

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec
from torchrl.data.utils import DEVICE_TYPING

from buggy_rl import keys
from buggy_rl.effects.base import Effect, numbers_spec

RESTING = (-1.0, 0.0)  # no drive, wheels straight: what a standing car was told
STANDING = 0.05  # [m/s] a car set down at less than this stands
GIVEN = "_given"  # ends the key of the next memory, which is there only while a step is taken


class CommandEffect(Effect):
    """u'_k = f(u_k) of one command, both in [-1, 1]; the engine would clamp what lies beyond."""

    kind = "actuation"
    channel: ClassVar[int]
    """0 throttle, 1 steering."""

    @abstractmethod
    def _acted(self, command: Tensor, tensordict: TensorDictBase) -> Tensor:
        """What the engine gets for the command [n] of the cars that feel the effect."""

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        if not self.active:
            return tensordict
        action = tensordict.get(keys.ACTION)
        asked = action[..., self.channel]
        acted = self._acted(self._take(asked, 0).clamp(-1.0, 1.0), tensordict).clamp(-1.0, 1.0)
        commands = list(action.unbind(-1))
        commands[self.channel] = self._put(asked, acted, 0)
        return tensordict.set(keys.ACTION, torch.stack(commands, -1))


class RememberingCommand(CommandEffect):
    """u'_k, s_k = f(u_k, s_{k-1}) with a state s [size] that rides in the TensorDict.

    A car that is set down standing had no drive and straight wheels before; one that is set down
    in motion is taken to have been told before what it is told first. The last number of the
    memory says that this is still to come.
    """

    lasting: ClassVar[bool] = False
    """Whether what was told seconds ago still matters: where there is play, on a long way of a slow
    servo, after a long lag."""

    @property
    def size(self) -> int:
        """Numbers of the state."""
        return 1

    def remembered(self, memory: Tensor, commands: Tensor) -> Tensor:
        """The memory [n, size + 1] of cars that were told `commands` [n, T] of this channel."""
        told = self._take(commands).clamp(-1.0, 1.0)
        state = told[:, :1].expand(-1, self.size)
        for command in told.unbind(1):
            state = self._moved(command, state)[1]
        return self._put(memory, torch.cat([state, torch.zeros_like(state[:, :1])], -1))

    @abstractmethod
    def _moved(self, command: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """What the engine gets [n], and the next state [n, size]."""

    def _acted(self, command: Tensor, tensordict: TensorDictBase) -> Tensor:
        memory = tensordict.get(self.memory)  # (*, size + 1)
        mine = self._take(memory)
        state, unknown = mine[..., :-1], mine[..., -1:]
        state = torch.where(unknown > 0.5, command.unsqueeze(-1), state)
        acted, state = self._moved(command, state)
        memory_given = torch.cat([state, torch.zeros_like(unknown)], -1)
        tensordict.set(self.memory + GIVEN, self._put(memory, memory_given))
        return acted

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        if not self.active:
            return next_tensordict
        return next_tensordict.set(self.memory, tensordict.get(self.memory + GIVEN))

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        if not self.active:
            return tensordict_reset
        velocity = tensordict_reset.get(keys.VELOCITY)
        moving = torch.linalg.vector_norm(velocity[..., :2], dim=-1, keepdim=True) > STANDING
        state = velocity.new_full((*velocity.shape[:-1], self.size), RESTING[self.channel])
        return tensordict_reset.set(self.memory, torch.cat([state, moving.to(velocity)], -1))

    def _state_specs(
        self, shape: torch.Size, device: DEVICE_TYPING | None
    ) -> dict[str, TensorSpec]:
        return {self.memory: numbers_spec(shape, self.size + 1, device=device)}
