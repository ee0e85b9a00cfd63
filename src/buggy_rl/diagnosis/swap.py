"""Swap step: alternatives of an effect that were never tried beside the other effects."""

from collections.abc import Mapping
from math import inf

from buggy_rl.diagnosis.candidate import Candidate, Effects, excess_misfit, substitutes
from buggy_rl.diagnosis.config import SelectionConfig
from buggy_rl.estimation.hypothesis import Hypothesis, Library


def swap_starts(
    library: Library, best: Candidate, tried: Mapping[Effects, Candidate], rules: SelectionConfig
) -> list[Hypothesis]:
    """The best hypothesis with one effect replaced, where each would begin.

    An effect is selected before the others are known: wind or a sloped floor, by what they close
    alone. Beside the others its alternative may close as much, or more.

    Args:
        library: Of the effects.
        best: Hypothesis of several effects; of fewer there are no swaps.
        tried: All hypotheses by their effects.
        rules: `swap_near`, `swap_each`.
    """
    first = excess_misfit(tried[()], tried[()])
    starts = []
    for effect in best.effects:
        others = frozenset(best.effects) - {effect}
        worse = _worse(best, tried, effect)
        near = sorted(
            (a for a in worse if worse[a][0] < rules.swap_near * first), key=lambda a: worse[a][0]
        )
        for alternative in near[: rules.swap_each]:
            # At the best's numbers; what it has none for, where the alternative was fitted.
            known = worse[alternative][1].fit.named() | best.fit.named()
            starts.append(library.at(sorted((*others, alternative)), known))
    return starts


def _worse(
    best: Candidate, tried: Mapping[Effects, Candidate], effect: str
) -> dict[str, tuple[float, Candidate]]:
    """Alternative of an effect -> excess by which it was worse beside fewer others, and where."""
    null, others = tried[()], frozenset(best.effects) - {effect}
    beside = frozenset(substitutes(tried, others))
    worse: dict[str, tuple[float, Candidate]] = {}
    for effects, candidate in tried.items():
        fewer = frozenset(effects) - {effect}
        if effect not in effects or not fewer < others:
            continue
        for alternative, other in substitutes(tried, fewer).items():
            more = excess_misfit(other, null) - excess_misfit(candidate, null)
            known = alternative in {"", *others, *beside}
            if not known and more < worse.get(alternative, (inf, other))[0]:
                worse[alternative] = more, other
    return worse
