"""Ways in which each effect may go, and what each changes of the residuals, from trial rollouts."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from buggy_rl.estimation.gauss_newton import Fit
from buggy_rl.estimation.hypothesis import Hypothesis

Way = tuple[str, tuple[float, ...]]
"""An effect, and a unit vector of its numbers [prior scales]."""


def unit_changes(base: Fit, rolled: Sequence[Fit]) -> tuple[list[Way], Tensor]:
    """Change of the whitened residuals by one prior scale of each way an effect may go.

    Of trials in the same direction the smallest counts; each place of a patch is one.

    Returns:
        Effect and direction of each column, and columns [N, D, Q].
    """
    smallest: dict[Way, tuple[float, Tensor]] = {}
    for trial in rolled:
        key, side = way_of(trial)
        size = abs(side)
        if key not in smallest or size < smallest[key][0]:
            smallest[key] = size, (trial.whitened - base.whitened) / side
    none = base.whitened.new_zeros(*base.whitened.shape, 0)  # all effects may be the base's
    columns = [column.unsqueeze(-1) for _, column in smallest.values()]
    return list(smallest), torch.cat([none, *columns], -1)


def way_of(trial: Hypothesis) -> tuple[Way, float]:
    """The way in which the last effect of a trial goes, and how far [prior scales].

    Both ways along a line are one: the first number that moves is positive.
    """
    own = [i for i, c in enumerate(trial.coordinates) if c.effect == trial.effects[-1]]
    vector = trial.vector[own]
    side = math.copysign(float(vector.norm()), next(z for z in vector.tolist() if z))
    return (trial.effects[-1], tuple(round(z / side, 6) for z in vector.tolist())), side
