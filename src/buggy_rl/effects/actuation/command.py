"""What effects on a command have in common: one channel, and a state that depends on the past."""

from abc import abstractmethod
from typing import ClassVar

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec
from torchrl.data.utils import DEVICE_TYPING

from buggy_rl import keys
from buggy_rl.effects.base import Effect, numbers_spec

STANDING = 0.05  # [m/s] speed below which a reset is a car at rest; chosen
GIVEN = "_given"  # ends the key of the next memory, present only while a step is taken


class CommandEffect(Effect):
    """u'_k = f(u_k) of one command, both clamped to [-1, 1]."""

    kind = "actuation"
    channel: ClassVar[int]
    """0 throttle, 1 steering."""

    @abstractmethod
    def _acting(self, command: Tensor, tensordict: TensorDictBase) -> Tensor:
        """Command [n] that acts instead of `command` [n], of the active rows."""

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        if not self.active:
            return tensordict
        action = tensordict.get(keys.ACTION)
        given = action[..., self.channel]
        acting = self._acting(self._gather(given, 0).clamp(-1.0, 1.0), tensordict).clamp(-1.0, 1.0)
        commands = list(action.unbind(-1))
        commands[self.channel] = self._scatter(given, acting, 0)
        return tensordict.set(keys.ACTION, torch.stack(commands, -1))


class RememberingCommand(CommandEffect):
    """u'_k, s_k = f(u_k, s_{k-1}) with a latent state s [size] in the TensorDict.

    After a reset at rest s is that of the resting commands. After a reset in motion s is unknown
    until the first command, which is then taken to have been given before as well; the last number
    of the memory is 1 until then.
    """

    lasting: ClassVar[bool] = False
    """Whether commands of seconds ago still matter: play, a rate limit, a long lag."""

    @property
    def size(self) -> int:
        """Numbers of the latent state."""
        return 1

    def remembered(self, memory: Tensor, commands: Tensor) -> Tensor:
        """Memory [n, size + 1] after the commands [n, T] of this channel."""
        given = self._gather(commands).clamp(-1.0, 1.0)
        state = given[:, :1].expand(-1, self.size)
        for command in given.unbind(1):
            state = self._next(command, state)[1]
        return self._scatter(memory, torch.cat([state, torch.zeros_like(state[:, :1])], -1))

    @abstractmethod
    def _next(self, command: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Command [n] that acts, and the next latent state [n, size]."""

    def _acting(self, command: Tensor, tensordict: TensorDictBase) -> Tensor:
        memory = tensordict.get(self.memory)  # (*, size + 1)
        rows = self._gather(memory)
        state, unknown = rows[..., :-1], rows[..., -1:]
        state = torch.where(unknown > 0.5, command.unsqueeze(-1), state)
        acting, state = self._next(command, state)
        next_rows = torch.cat([state, torch.zeros_like(unknown)], -1)
        tensordict.set(self.memory + GIVEN, self._scatter(memory, next_rows))
        return acting

    def _write_step(self, before: TensorDictBase, after: TensorDictBase) -> None:
        after.set(self.memory, before.get(self.memory + GIVEN))

    def _write_reset(self, given: TensorDictBase, state: TensorDictBase) -> None:
        velocity = state.get(keys.VELOCITY)
        moving = torch.linalg.vector_norm(velocity[..., :2], dim=-1, keepdim=True) > STANDING
        straight = 0.0 if self.channel else self.rest
        resting = velocity.new_full((*velocity.shape[:-1], self.size), straight)
        state.set(self.memory, torch.cat([resting, moving.to(velocity)], -1))

    def _state_specs(
        self, shape: torch.Size, device: DEVICE_TYPING | None
    ) -> dict[str, TensorSpec]:
        return {self.memory: numbers_spec(shape, self.size + 1, device=device)}
