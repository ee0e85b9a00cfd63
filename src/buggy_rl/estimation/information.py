"""Normal equations of least squares, block by block, and what is left of them without some."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, eq=False)
class Information:
    """Normal equations of numbers x of each of G blocks, or of all: 1/2 x^T H x + g^T x."""

    hessian: Tensor
    """[G, X, X]"""
    score: Tensor
    """[G, X]"""

    def factor(self, own: int, precision: Tensor) -> tuple[Tensor, Tensor]:
        """Cholesky factor [G, Q, Q] of the last Q numbers' deviations u ~ N(0, 1 / precision [Q]).

        And the volume [nats] by which the evidence is less for them, of all blocks.

        Args:
            own: Numbers before them, which do not deviate.
            precision: [Q]
        """
        root = torch.linalg.cholesky(self.hessian[:, own:, own:] + torch.diag(precision))
        volume = root.diagonal(dim1=1, dim2=2).log().sum(-1) - 0.5 * precision.log().sum()
        return root, volume.sum()

    def without(self, own: int, factor: Tensor) -> "Information":
        """What is left where deviations have been integrated over."""
        right = self.hessian[..., own:]  # (G, X, Q)
        hessian = self.hessian - right @ torch.cholesky_solve(right.mT, factor)
        gain = torch.cholesky_solve(self.score[..., own:].unsqueeze(-1), factor)
        return Information(hessian, self.score - (right @ gain).squeeze(-1))

    def deviations(self, own: int, factor: Tensor, x: Tensor) -> Tensor:
        """The most probable deviations [G, Q] where the common numbers are x [X]."""
        score = self.score[:, own:] + self.hessian[:, own:, :] @ x
        return -torch.cholesky_solve(score.unsqueeze(-1), factor).squeeze(-1)

    def of(self, numbers: Sequence[int]) -> "Information":
        """Normal equations of some of the numbers, the others being none."""
        index = torch.tensor(numbers, dtype=torch.long)
        return Information(self.hessian[..., index, :][..., index], self.score[..., index])

    def total(self) -> "Information":
        """The sum over blocks."""
        return Information(self.hessian.sum(0), self.score.sum(0))


def by_block(columns: Tensor, whitened: Tensor, weight: Tensor, block: Tensor) -> Information:
    """Normal equations of columns [N, D, X] that change residuals [N, D], by block [N] of G."""
    weighted = columns * weight[:, None, None]
    curve, along = columns.mT @ weighted, (weighted.mT @ whitened.unsqueeze(-1)).squeeze(-1)
    count = int(block.max()) + 1
    hessian, score = (
        part.new_zeros(count, *part.shape[1:]).index_add_(0, block, part) for part in (curve, along)
    )
    return Information(hessian, score)
