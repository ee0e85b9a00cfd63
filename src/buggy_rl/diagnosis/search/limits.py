"""Effects that are another effect in a limit of their numbers, and are said as that one.

A patch of another floor that holds all that was driven is another floor; a short dead time beside
a lag is how a line of two lags begins. Sets with the one and with the other are the same hypothesis
in two words, so their probabilities add before anything is named.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial

import torch
from torch import Tensor

from buggy_rl.diagnosis.search.candidate import Candidate, Effects
from buggy_rl.diagnosis.search.posterior import NORMAL
from buggy_rl.estimation.hypothesis import Hypothesis, Library
from buggy_rl.estimation.segments import Segments

PROMISING = 6  # sets that are fitted in the words of their limit; chosen
COVERED = 0.95  # [-] share of the driven rows inside a patch from which it is the floor
# [-] dead time over the lag beside it, below which it is a second lag in the line, of at most half
# the first: of a small lag half counts as dead time (Skogestad 2003, J. Process Control 13, 291).
OF_THE_LAG = 0.25


@dataclass(frozen=True)
class Limit:
    """An effect, and the one that it becomes."""

    effect: str
    becomes: str
    reached: Callable[[Candidate, Segments], bool]
    numbers: Mapping[str, str] = field(default_factory=dict)
    """Number of `becomes` -> that of `effect` which it is then; none where both are in the set."""
    words: str = ""
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


def is_of_the_lag(candidate: Candidate, _: Segments, *, dead_time: str, lag: str) -> bool:
    """Whether a dead time is so short beside a lag that it is the beginning of a line of two."""
    values = candidate.fit.values()
    return (
        lag in values and values[dead_time]["dead_time"] < OF_THE_LAG * values[lag]["time_constant"]
    )


LIMITS = (
    Limit(
        "grip_patch",
        "tire_grip",
        covers_what_was_driven,
        {"grip": "grip"},
        ", wherever it was driven",
    ),
    *(
        Limit(dead_time, lag, partial(is_of_the_lag, dead_time=dead_time, lag=lag))
        for dead_time, lag in (
            ("throttle_dead_time", "throttle_lag"),
            ("steering_dead_time", "steering_lag"),
        )
    ),
)


def limits_within(library: Library) -> int:
    """Number of effects of a library in whose place another of its effects is fitted in a limit."""
    effects = {*library.effects}
    return sum(bool(x.numbers) and {x.effect, x.becomes} <= effects for x in LIMITS)


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
            if p.name in limit.numbers:
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
