"""What effects on a command have in common: one channel, and a state that depends on the past."""

from abc import abstractmethod
from typing import ClassVar

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec
from torchrl.data.utils import DEVICE_TYPING

from buggy_rl.core import keys
from buggy_rl.effects.base import Effect, numbers_spec

STANDING = 0.05  # [m/s] speed below which a reset is a car at rest; chosen
FARTHEST = 2.0  # [-] largest command that acts, where an effect extends it; engines end there
GIVEN = "_given"  # ends the key of the next memory, present only while a step is taken


class CommandEffect(Effect):
    """u'_k = f(u_k) of one command, u in [-1, 1].

    So is u', except of an effect that `extends` it: the part beyond 1 is handed on under
    `keys.BEYOND`, and an engine whose laws go on there (`Engine.reach`) adds it to the command.
    """

    kind = "actuation"
    may_delay = False
    channel: ClassVar[int]
    """0 throttle, 1 steering."""
    extends: ClassVar[bool] = False
    """Whether more than a full command may act: a higher voltage, a longer servo horn."""

    @abstractmethod
    def _acting(self, command: Tensor, tensordict: TensorDictBase) -> Tensor:
        """Command [n] that acts instead of `command` [n], of the active rows."""

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        if not self.active:
            return tensordict
        action, beyond = tensordict.get(keys.ACTION), tensordict.get(keys.BEYOND, None)
        given = action[..., self.channel]
        command = self._gather(given, 0).clamp(-1.0, 1.0)
        if self.extends and beyond is not None:
            command = command + self._gather(beyond[..., self.channel], 0)
        acting = self._acting(command, tensordict)
        within = acting.clamp(-1.0, 1.0)
        if self.extends or beyond is not None:
            past = acting.clamp(-FARTHEST, FARTHEST) - within if self.extends else 0 * within
            self._hand_on(tensordict, past)
        tensordict.set(keys.ACTION, self._replaced(action, within))
        return tensordict

    def _hand_on(self, tensordict: TensorDictBase, past: Tensor) -> None:
        """Hands on what acts [n] past +-1."""
        beyond = tensordict.get(keys.BEYOND, None)
        if beyond is None:
            beyond = torch.zeros_like(tensordict.get(keys.ACTION))
        tensordict.set(keys.BEYOND, self._replaced(beyond, past))

    def _replaced(self, pair: Tensor, part: Tensor) -> Tensor:
        """A pair [*, 2] with the active rows of its own channel replaced by `part` [n]."""
        columns = list(pair.unbind(-1))
        columns[self.channel] = self._scatter(columns[self.channel], part, 0)
        return torch.stack(columns, -1)


class RememberingCommand(CommandEffect):
    """u'_k, s_k = f(u_k, s_{k-1}) with a latent state s [size] in the TensorDict.

    After a reset at rest s is that of the resting commands. After a reset in motion s is unknown
    until the first command, which is then taken to have been given before as well; the last number
    of the memory is 1 until then.
    """

    may_delay = True
    lasting: ClassVar[bool] = False
    """Whether commands of seconds ago still matter: play, a rate limit, a long lag."""

    @property
    def size(self) -> int:
        """Numbers of the latent state."""
        return 1

    @property
    def resting(self) -> float:
        """Each number of the latent state of a car at rest."""
        return 0.0 if self.channel else self.rest

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
        state, unknown = self._recalled(tensordict)
        state = torch.where(unknown, command.unsqueeze(-1), state)
        acting, state = self._next(command, state)
        self._keep(tensordict, state)
        return acting

    def _recalled(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
        """Latent state [n, size] after the last step, and whether it is unknown [n, 1]."""
        rows = self._gather(tensordict.get(self.memory))
        return rows[..., :-1], rows[..., -1:] > 0.5

    def _keep(self, tensordict: TensorDictBase, state: Tensor) -> None:
        """Keeps the latent state [n, size] that a step will have led to."""
        known = torch.cat([state, torch.zeros_like(state[..., :1])], -1)
        memory = tensordict.get(self.memory)  # (*, size + 1)
        tensordict.set(self.memory + GIVEN, self._scatter(memory, known))

    def _write_step(self, before: TensorDictBase, after: TensorDictBase) -> None:
        after.set(self.memory, before.get(self.memory + GIVEN))

    def _write_reset(self, given: TensorDictBase, state: TensorDictBase) -> None:
        velocity = state.get(keys.VELOCITY)
        moving = torch.linalg.vector_norm(velocity[..., :2], dim=-1, keepdim=True) > STANDING
        resting = velocity.new_full((*velocity.shape[:-1], self.size), self.resting)
        state.set(self.memory, torch.cat([resting, moving.to(velocity)], -1))

    def _state_specs(
        self, shape: torch.Size, device: DEVICE_TYPING | None
    ) -> dict[str, TensorSpec]:
        return {self.memory: numbers_spec(shape, self.size + 1, device=device)}
