"""What a search goes by: blocks that are held out, and what is usual on the baseline."""

from dataclasses import dataclass

from torch import Tensor

from buggy_rl.diagnosis.config import DEFAULTS, SearchConfig
from buggy_rl.estimation.evidence import NO_BASELINE, BaselineMisfit
from buggy_rl.estimation.gauss_newton import Problem


@dataclass(frozen=True, eq=False)
class Criteria:
    """Blocks, baseline and numerical settings of a search."""

    group: Tensor
    """[N] blocks of segments that are held out together."""
    usual: BaselineMisfit = NO_BASELINE
    baseline: Problem | None = None
    """Problem on segments on which the simulator counts as right."""
    rules: SearchConfig = DEFAULTS
    anew: bool = True
    """Whether what is held out is rolled out anew; predicted to first order otherwise."""
