"""Statistics of episodes that begin and end anywhere in a stream of batches."""

import math
from collections import deque
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from buggy_rl import keys

EPISODES = 100  # last finished ones, over which is averaged


class Episodes:
    """Length, reward and waypoints of the last episodes that were seen from their beginning.

    Args:
        batch_size: Of the environment.
        whole: Whether the present episodes count.
        device: Of the batches.
    """

    def __init__(
        self, batch_size: torch.Size, whole: bool, device: torch.device | None = None
    ) -> None:
        self.whole = torch.full((*batch_size, 1), whole, device=device)
        self.running = torch.zeros(*batch_size, 3, device=device)  # of the present episode
        self.last: deque[list[float]] = deque(maxlen=EPISODES)

    def take(self, batch: TensorDictBase) -> None:
        """Notes the episodes that end in a batch [cars, time]."""
        done, reward = batch["next", keys.DONE], batch["next", keys.REWARD]  # (cars, time, 1)
        closed = batch.get(("next", keys.WAYPOINTS_CLOSED), torch.full_like(reward, math.nan))
        row = torch.cat([torch.ones_like(reward), reward, closed], -1)  # (cars, time, 3)
        total = row.cumsum(-2) + self.running.unsqueeze(-2)
        ended_before, before = _at_last_end(total, done)
        counted = done & (ended_before | self.whole.unsqueeze(-2))
        self.last.extend((total - before)[counted.squeeze(-1)].tolist())
        self.whole = self.whole | done.any(-2)
        at_end = torch.where(done[..., -1, :], total[..., -1, :], before[..., -1, :])
        self.running = total[..., -1, :] - at_end

    def means(self) -> dict[str, float]:
        """`episode_length`, `episode_reward`, `waypoints`; nan before the first one."""
        names = ("episode_length", "episode_reward", "waypoints")
        values = torch.tensor(list(self.last) or [[math.nan] * len(names)]).mean(0).tolist()
        return dict(zip(names, values, strict=True))

    def state_dict(self) -> dict[str, Any]:
        """What a resumed run needs."""
        return {"whole": self.whole, "running": self.running, "last": list(self.last)}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Goes back to where `state_dict` was taken."""
        self.whole.copy_(state["whole"])
        self.running.copy_(state["running"])
        self.last = deque(state["last"], EPISODES)


def _at_last_end(total: Tensor, done: Tensor) -> tuple[Tensor, Tensor]:
    """Whether an episode ended in this batch before a step, and `total` [*, time, 3] there."""
    step = torch.arange(done.shape[-2], device=done.device).unsqueeze(-1)
    end = torch.where(done, step, -1).cummax(-2).values
    end = torch.cat([torch.full_like(end[..., :1, :], -1), end[..., :-1, :]], -2)  # before it
    at_end = total.gather(-2, end.clamp_min(0).expand_as(total))
    return end >= 0, torch.where(end >= 0, at_end, 0.0)
