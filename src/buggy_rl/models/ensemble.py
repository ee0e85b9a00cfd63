"""Several models of one kind with different initial weights; the prediction is their mean."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from buggy_rl.models.base import DynamicsModel


class Ensemble(DynamicsModel):
    """Mean of its members' changes of velocity; their standard deviation is its uncertainty."""

    def __init__(self, members: Sequence[DynamicsModel]) -> None:
        super().__init__(members[0].rows)
        self.members = members
        self._registered = nn.ModuleList(members)

    def network(self, history: Tensor) -> Tensor:
        return self._each(history).mean(0)

    def spread(self, history: Tensor) -> Tensor:
        """Standard deviation [*, 3] of the members' change of velocity for a history."""
        normalised = (history - self.input_mean) / self.input_scale
        return self._each(normalised).std(0) * self.output_scale

    def _each(self, history: Tensor) -> Tensor:
        # Members share the ensemble's normalisation: they are trained on the same data.
        return torch.stack([member.network(history) for member in self.members])  # (M, *, 3)
