"""How strongly what is concealed shows: what the truth gains on held-out blocks, in nats.

Strength of an effect = least held-out loss of the sets without it, less that of the true set. Sets
without it: the rest of the truth, alone and with each of the most promising other effects. That
counts a deviation of the car from block to block as noise of each segment, and so too much where
there is one; `changed_strengths` does not.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from torch import Tensor

from buggy_rl.diagnosis.run.case import Criteria
from buggy_rl.diagnosis.search.changed import Changed, usual
from buggy_rl.diagnosis.search.ways import unit_changes
from buggy_rl.estimation.evidence import cross_validated
from buggy_rl.estimation.gauss_newton import Fit, Problem
from buggy_rl.estimation.sparse import trials
from buggy_rl.proof.score.oracle import JOINED, TrueFits

VISIBLE = 6.0  # [nats] strength above which an effect can be found
STRENGTHS = (-math.inf, 0.0, VISIBLE, 12.0, 30.0, 100.0, 300.0, 1000.0)
"""[nats] above which names are counted, for a curve over strength."""


def strengths(fits: TrueFits, group: Tensor) -> dict[str, Any]:
    """Nats against nothing, against each set, by effect, and fitted numbers.

    Args:
        fits: Of what is concealed.
        group: [N] blocks of segments that are held out together.
    """
    sets = list(fits.others)
    own, nothing, *losses = held_out_losses(
        fits.problem, [fits.truth, fits.null, *fits.others.values()], group
    )
    gains = {name: loss - own for name, loss in zip(sets, losses, strict=True)}
    return fits.costs | {
        "nats": nothing - own,
        "rivals": gains,
        "strength": {e: _least(e, gains, nothing - own) for e in fits.truth.effects},
    }


def changed_strengths(fits: TrueFits, criteria: Criteria) -> dict[str, float]:
    """Strength of each effect by the evidence beside what simulator and car differ in anyway.

    Args:
        fits: Of what is concealed.
        criteria: Blocks and baseline of the diagnosis.
    """
    problem, null = fits.problem, fits.null
    known = None if criteria.baseline is None else usual(criteria.baseline)
    changes = unit_changes(null, problem.rolled_out(trials(problem, null)))
    since = Changed.since(known, problem, criteria.group, null, changes)
    own, nothing, *others = since.log_evidence([fits.truth, null, *fits.others.values()])
    gains = {name: own - other for name, other in zip(fits.others, others, strict=True)}
    return {effect: _least(effect, gains, own - nothing) for effect in fits.truth.effects}


def _least(effect: str, gains: Mapping[str, float], nothing: float) -> float:
    return min(nothing, *(g for name, g in gains.items() if effect not in name.split(JOINED)))


def held_out_losses(problem: Problem, fits: Sequence[Fit], group: Tensor) -> list[float]:
    """Loss of each fit on the blocks that it was not fitted to, with the prior's [nats]."""
    validated = cross_validated(problem, fits, group)
    return [
        float(problem.noise.loss(held_out.square, problem.dispersion).sum() + fit.penalty())
        for held_out, fit in zip(validated, fits, strict=True)
    ]
