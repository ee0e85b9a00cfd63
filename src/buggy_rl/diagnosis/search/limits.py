"""Effects that are another effect in a limit of their numbers, and are said as that one.

A patch of another floor that holds all that was driven is another floor. Sets with the one and with
the other are the same hypothesis in two words, so their probabilities add before anything is named.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from buggy_rl.diagnosis.search.candidate import Candidate, Effects
from buggy_rl.diagnosis.search.posterior import NORMAL
from buggy_rl.estimation.hypothesis import Hypothesis, Library
from buggy_rl.estimation.segments import Segments

PROMISING = 6  # sets that are fitted in the words of their limit; chosen
COVERED = 0.95  # [-] share of the driven rows inside a patch from which it is the floor


@dataclass(frozen=True)
class Limit:
    """An effect, and the one that it becomes."""

    effect: str
    becomes: str
    reached: Callable[[Candidate, Segments], bool]
    numbers: Mapping[str, str]
    """Number of `becomes` -> that of `effect` which it is then."""
    words: str
    """Words added to the sentence of `becomes`."""


def covers_what_was_driven(candidate: Candidate, segments: Segments) -> bool:
    """Whether a grip patch holds nearly all rows, or none lies surely outside of it."""
    values = candidate.fit.values()["grip_patch"]
    centre = torch.tensor([values["x"], values["y"]])
    away = torch.linalg.vector_norm(segments.pose[..., :2].flatten(0, 1) - centre, dim=-1)
    if float((away <= values["radius"]).double().mean()) > COVERED:
        return True
    sd = _deviations(candidate, "grip_patch")
    reach = values["radius"] + NORMAL * (
        sd["radius"] + float(torch.tensor([sd["x"], sd["y"]]).norm())
    )
    return not bool((away > reach).any())


LIMITS = (
    Limit(
        "grip_patch",
        "tire_grip",
        covers_what_was_driven,
        {"grip": "grip"},
        ", wherever it was driven",
    ),
)


def limits_within(library: Library) -> int:
    """Number of effects of a library that another of its effects becomes in a limit."""
    return sum({limit.effect, limit.becomes} <= {*library.effects} for limit in LIMITS)


def same_sets(tried: Mapping[Effects, Candidate], segments: Segments) -> dict[Effects, Effects]:
    """Sets of which an effect has reached its limit -> the fitted set that they are the same as."""
    return {key: other for key, _, other in _reached(tried, segments) if other in tried}


def missing_hypotheses(
    tried: Mapping[Effects, Candidate], segments: Segments, library: Library
) -> list[Hypothesis]:
    """Sets that others are the same as and that were not fitted, where their fits begin.

    Args:
        tried: What was fitted, the most promising first.
        segments: Of the recordings.
        library: What hypotheses are of.
    """
    starts: dict[Effects, Hypothesis] = {}
    for key, limit, other in _reached(tried, segments):
        if other in tried or other in starts or limit.becomes not in library.effects:
            continue
        fit = tried[key].fit
        known, values = fit.named(), fit.values()[limit.effect]
        for p in library.numbers(limit.becomes):
            known[limit.becomes, p.name] = float(p.coordinate(values[limit.numbers[p.name]]))
        starts[other] = library.at(other, known)
    return list(starts.values())[:PROMISING]


def words_of(effect: str, same: Mapping[Effects, Effects]) -> str:
    """What is added to an effect's sentence, where other sets are said by it."""
    for limit in LIMITS:
        if effect == limit.becomes and any(limit.effect in key for key in same):
            return limit.words
    return ""


def _reached(
    tried: Mapping[Effects, Candidate], segments: Segments
) -> Iterator[tuple[Effects, Limit, Effects]]:
    for limit in LIMITS:
        for key, candidate in tried.items():
            if limit.effect in key and limit.reached(candidate, segments):
                yield key, limit, tuple(sorted({*key} - {limit.effect} | {limit.becomes}))


def _deviations(candidate: Candidate, effect: str) -> dict[str, float]:
    """Standard deviation of each number of an effect, in its unit, by leaving out blocks."""
    variance: Tensor = candidate.cross_validated.covariance.diagonal().clamp_min(0.0)
    numbers = zip(candidate.fit.coordinates, variance.sqrt().tolist(), strict=True)
    return {c.parameter.name: sd * c.parameter.size for c, sd in numbers if c.effect == effect}
