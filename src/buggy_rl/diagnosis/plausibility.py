"""Whether fitted numbers of effects are such as real cars have, and whether they mean anything.

Plausibility is said, and bounds what is claimed. It is no part of the probabilities: development
cases, which those are fitted to, draw effects larger than usual on purpose.
"""

from collections.abc import Mapping, Sequence

import torch

from buggy_rl.diagnosis.named_effect import Value
from buggy_rl.effects.base import EffectParameter
from buggy_rl.estimation.hypothesis import CLOCK, CLOCK_PRIOR
from buggy_rl.estimation.segments import Segments

FAR_CLOCK = 3 * CLOCK_PRIOR * CLOCK.size  # [s] three standard deviations of a stamp's error
CLOCKLIKE = ("sensor_latency",)  # effects that are a clock's error as well
WHOLE = 0.95  # [-] share of a number's range that an interval without meaning spans
IMPLAUSIBLE = (
    4.0  # times as far from neutral as the usual end: beyond all that is drawn, by a third
)
PLACES = ("x", "y")  # numbers that are places in the room, in effects that have a radius


def unusual(numbers: Sequence[EffectParameter], values: Mapping[str, float]) -> tuple[str, ...]:
    """Names of numbers outside what 5 to 95 % of real cars have."""
    return tuple(
        p.name
        for p in numbers
        if p.usual is not None and not p.usual[0] <= values[p.name] <= p.usual[1]
    )


def implausible(numbers: Sequence[EffectParameter], values: Mapping[str, float]) -> bool:
    """Whether a number is so far beyond the usual ones that another effect is more probable.

    Distances are of the normalised value from neutral. Sizes that development cases draw, to
    which the probabilities are calibrated, are all within.
    """
    for p in numbers:
        if p.usual is not None:
            found, *ends = (p.coordinate(v) for v in (values[p.name], *p.usual))
            low, high = min(0.0, *ends), max(0.0, *ends)
            if not IMPLAUSIBLE * low <= found <= IMPLAUSIBLE * high:
                return True
    return False


def undetermined(
    numbers: Sequence[EffectParameter], values: Mapping[str, Value], segments: Segments
) -> tuple[str, ...]:
    """Names of numbers whose interval is wider than what the number can mean.

    A place in the room means something within what was driven; another number within its range.
    """
    patch = "radius" in {p.name for p in numbers}
    driven = segments.pose[..., :2].flatten(0, 1)
    room = (driven.amax(0) - driven.amin(0)).tolist()  # [m] along x and y
    found = []
    for p in numbers:
        width = values[p.name].high - values[p.name].low
        if patch and p.name in PLACES:
            meant = room[PLACES.index(p.name)]
        elif patch and p.name == "radius":
            meant = float(torch.tensor(room).norm())
        else:
            meant = WHOLE * (p.upper - p.lower)
        if width >= meant:
            found.append(p.name)
    return tuple(found)


def latencies_refused(clock_offset: float) -> tuple[str, ...]:
    """Effects that are not named beside a clock that is itself off by more than stamps are.

    Of a late sensor and an early clock only the difference is known: their numbers may be anything.
    """
    return CLOCKLIKE if abs(clock_offset) >= FAR_CLOCK - 1e-6 else ()
