"""An explanation and what speaks for it."""

from dataclasses import dataclass

from torch import Tensor

from buggy_rl.diagnosis.adequacy import misfit, typical
from buggy_rl.diagnosis.evidence import Evidence
from buggy_rl.diagnosis.fit import Fitted


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
