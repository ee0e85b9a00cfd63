"""Greedy forward selection by BIC: one effect after the other, until none lowers it."""

import math
from pathlib import Path
from typing import Any

from buggy_rl.estimation.evidence import cross_validated
from buggy_rl.proof.baselines.asked import all_named, effect_said, open_question, unnamed
from buggy_rl.proof.baselines.each import (
    half_bic,
    large,
    numbers_of,
    single_fits,
    with_one_more,
)

MOST = 3  # effects that are named
CLOSEST = 4  # effects that are fitted beside those chosen, the most promising by a rollout of each


def greedy(seen: Path) -> dict[str, Any]:
    """Names the effects by which forward selection lowers BIC; nothing where none does.

    Begins with the fits of each effect alone (`each`). In each further round every other effect is
    rolled out beside those chosen, and the `CLOSEST` are fitted with them. The confidence of an
    effect is 1 / (1 + exp(-gain)) with what adding it gained of BIC / 2.
    """
    asked = open_question(seen)
    singles = single_fits(asked)
    problem, chosen, gains = singles.problem, singles.fits[0], list[float]()
    candidates = large(singles.fits[1:])
    while candidates:
        best = min(candidates, key=lambda fit: half_bic(problem, fit))
        gain = half_bic(problem, chosen) - half_bic(problem, best)
        if gain <= 0:
            break
        chosen, gains = best, [*gains, gain]
        candidates = large(with_one_more(problem, chosen, CLOSEST)) if len(gains) < MOST else []
    if not gains:
        return unnamed("no_mismatch", "no effect lowers BIC")
    [held_out] = cross_validated(problem, [chosen], asked.ready.criteria.group)
    said = [
        effect_said(name, 1 / (1 + math.exp(-gain)), numbers_of(chosen, name, held_out.covariance))
        for name, gain in zip(chosen.effects, gains, strict=True)
    ]
    told = ", ".join(f"{n} {gain:.1f}" for n, gain in zip(chosen.effects, gains, strict=True))
    return all_named("missing_physics", said, [f"gains in nats: {told}"])
