"""An explanation and what speaks for it."""

from collections.abc import Mapping
from dataclasses import dataclass

from torch import Tensor

from buggy_rl.estimation.cross_validation import Evidence
from buggy_rl.estimation.gauss_newton import Fitted
from buggy_rl.estimation.misfit import misfit, typical


@dataclass
class Candidate:
    """An explanation, fitted, with what speaks for it."""

    fitted: Fitted
    evidence: Evidence

    @property
    def causes(self) -> tuple[str, ...]:
        """What it explains the drives by."""
        return self.fitted.causes

    @property
    def held_out(self) -> Tensor:
        """[N] mean square of each stretch when its block was held out, over noise."""
        return self.evidence.square / self.fitted.white.shape[-1]

    @property
    def typical(self) -> float:
        """What is usual among them."""
        return typical(self.held_out)


def size(candidate: Candidate, null: Candidate) -> float:
    """Excess of gaps on what was held out over the noise's, beside those of nothing at all."""
    return misfit(candidate.held_out, null.held_out) - 1


def in_its_place(
    tried: Mapping[tuple[str, ...], Candidate], others: frozenset[str]
) -> dict[str, Candidate]:
    """Explanations by these causes and one more, by the one; none more under the empty name."""
    result = {}
    for causes, candidate in tried.items():
        more = frozenset(causes) - others
        if (
            others <= frozenset(causes)
            and len(more) <= 1
            and len(causes) == len(others) + len(more)
        ):
            result[next(iter(more), "")] = candidate
    return result
