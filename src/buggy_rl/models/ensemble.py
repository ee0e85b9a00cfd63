"""Several models of one kind with different initial weights; the prediction is their mean."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from buggy_rl.models.base import DynamicsModel


class Ensemble(DynamicsModel):
    """Mean of its members' changes of velocity."""

    def __init__(self, members: Sequence[DynamicsModel]) -> None:
        super().__init__(members[0].rows)
        self.members = members
        self._registered = nn.ModuleList(members)

    def network(self, history: Tensor) -> Tensor:
        # Members share the ensemble's normalisation: they are trained on the same data.
        return torch.stack([member.network(history) for member in self.members]).mean(0)
