"""How strongly what is concealed shows: what the truth gains on held-out blocks, in nats.

Strength of an effect = least held-out loss of the sets without it, less that of the true set. Sets
without it: the rest of the truth, alone and with each of the most promising other effects.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from buggy_rl.diagnosis.run.case import DiagnosisCase
from buggy_rl.estimation.evidence import cross_validated
from buggy_rl.estimation.gauss_newton import Fit, Problem, fitted
from buggy_rl.estimation.hypothesis import Hypothesis
from buggy_rl.estimation.sparse import screened
from buggy_rl.proof.cases.equivalents import meant
from buggy_rl.proof.score.oracle import ITERATIONS, Numbers, true_fit

JOINED = "+"
MORE = 6  # promising ones looked at beyond those wanted: some are the truth by another name
VISIBLE = 6.0  # [nats] strength above which an effect can be found


def strengths(ready: DiagnosisCase, true: Numbers, rivals: int) -> dict[str, Any]:
    """Nats against nothing, against each set, by effect, and fitted numbers.

    Args:
        ready: What the diagnosis itself searches.
        true: What is concealed: effects of the library, or terms.
        rivals: Other effects that are fitted.
    """
    problem, truth = true_fit(ready.problem, true)
    [null] = fitted(problem, [problem.library.hypothesis(())], ITERATIONS)
    sets = _without_each(problem, null, truth, rivals)
    found = fitted(problem, list(sets.values()), ITERATIONS)
    own, nothing, *losses = held_out_losses(ready, problem, [truth, null, *found])
    gains = {name: loss - own for name, loss in zip(sets, losses, strict=True)}
    return {
        "nats": nothing - own,
        "rivals": gains,
        "strength": {effect: _least(effect, gains, nothing - own) for effect in true},
        "parameters": {effect: v for effect, v in truth.values().items() if effect},
        "temper": problem.dispersion,
    }


def _least(effect: str, gains: Mapping[str, float], nothing: float) -> float:
    return min(nothing, *(g for name, g in gains.items() if effect not in name.split(JOINED)))


def held_out_losses(ready: DiagnosisCase, problem: Problem, fits: Sequence[Fit]) -> list[float]:
    """Loss of each fit on the blocks that it was not fitted to, with the prior's [nats]."""
    validated = cross_validated(problem, fits, ready.criteria.group)
    return [
        float(problem.noise.loss(held_out.square, problem.dispersion).sum() + fit.penalty())
        for held_out, fit in zip(validated, fits, strict=True)
    ]


def _without_each(problem: Problem, null: Fit, truth: Fit, rivals: int) -> dict[str, Hypothesis]:
    """Sets without each effect of the truth: the rest, alone and with each other effect."""
    others = [
        start
        for start in screened(problem, null, rivals + MORE)
        if meant(start.effects[-1]) not in truth.effects
    ][:rivals]
    found: dict[str, Hypothesis] = {}
    for left_out in truth.effects:
        rest = [effect for effect in truth.effects if effect != left_out]
        sets = [problem.library.at(rest, truth.named())] if rest else []
        sets += [
            problem.library.at([*rest, *start.effects], {**truth.named(), **start.named()})
            for start in others
        ]
        found |= {JOINED.join(start.effects): start for start in sets}
    return found
