"""Form errors fitted to development cases, so that intervals cover as often as they say.

Of every case whose true set was fitted, each number of it, what it is in truth, and what remained.
The form error is the narrowest that covers `COVERED` of the numbers, by the geometric mean of the
half widths: intervals scaled as in conformal prediction (Papadopoulos et al. 2008, normalised
residuals), without a distribution assumed. A mean of widths or distances would be that of the
few numbers at the bounds.
"""

import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from buggy_rl.blind_test.calibration import Entry, group, truth, unknown
from buggy_rl.blind_test.case import Case
from buggy_rl.blind_test.oracle import expected
from buggy_rl.blind_test.statistics import Figure, share
from buggy_rl.diagnosis.case_evidence import CaseEvidence, HypothesisEvidence
from buggy_rl.diagnosis.form_error import FormError
from buggy_rl.diagnosis.named_effect import NORMAL
from buggy_rl.effects import effect_class

CHANCE = (1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0)  # tried
ALWAYS = (0.0, 0.01, 0.02, 0.03, 0.05, 0.08, 0.12, 0.17, 0.24, 0.34)  # tried
REMAINS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.7, 1.0)  # tried
TRIED = [FormError(*of) for of in product(CHANCE, ALWAYS, REMAINS)]
COVERED = 0.95
REDEFINED = {"cornering_drag": "steps"}
"""Effects whose equation has changed -> what lines of ledgers have since: numbers in earlier lines
are of another equation. Until then cornering_drag was -c |vx r|, and step tests were not kept."""
FINEST = 1e-6  # [prior scales] added to half widths before a logarithm


@dataclass(frozen=True)
class Number:
    """A fitted number of the true set."""

    z: float
    true: float
    by_blocks: float
    """[prior scales] standard deviation by leaving out blocks."""
    share: float
    """What remains over what its effect closes."""
    group: str

    def half_width(self, form: FormError) -> float:
        """Of its 95 % interval [prior scales]."""
        return NORMAL * form.sd(self.z, self.by_blocks, self.share)


def numbers(entries: Sequence[Entry]) -> list[Number]:
    """Of all cases whose true set was fitted, and has a number in truth."""
    found = []
    for entry in entries:
        if not truth(entry) or unknown(entry):
            continue
        seen = CaseEvidence.from_dict(entry)
        own = seen.of(truth(entry))
        found += [] if own is None else _of(entry, seen, own)
    return found


def _of(entry: Entry, seen: CaseEvidence, own: HypothesisEvidence) -> list[Number]:
    case = Case(**entry["case"])
    names = [(e, p) for e, values in own.values.items() if e for p in values]
    found = []
    for (effect, name), z, sd in zip(names, own.z, own.sd, strict=False):  # the clock is last
        value = expected(case, effect).get(name)
        today = effect not in REDEFINED or REDEFINED[effect] in entry
        if value is not None and today:
            [parameter] = [p for p in effect_class(effect).declared if p.name == name]
            true = float(parameter.coordinate(value))
            closed = seen.without(own, effect).excess - own.excess
            share = seen.usual.remaining(own.excess, closed)
            found.append(Number(z, true, sd, share, group(entry)))
    return found


def form_error(of: Sequence[Number]) -> FormError:
    """The narrowest of `TRIED` that covers; the widest where none does."""
    return narrowest(*_tried(of))


def left_out(of: Sequence[Number]) -> list[tuple[Number, FormError]]:
    """Each number with the form error of all other groups."""
    half, inside = _tried(of)
    group_of = np.array([n.group for n in of])
    forms = {g: narrowest(half[:, group_of != g], inside[:, group_of != g]) for g in {*group_of}}
    return [(n, forms[n.group]) for n in of]


def _tried(of: Sequence[Number]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Half widths [tried, numbers], and whether the truth is inside."""
    z, true, by_blocks, share = (
        np.array([getattr(n, name) for n in of]) for name in ("z", "true", "by_blocks", "share")
    )
    half = NORMAL * np.stack([form.sd(z, by_blocks, share) for form in TRIED])
    return half, np.abs(z - true) <= half


def narrowest(
    half: NDArray[np.float64], inside: NDArray[np.bool_], tried: Sequence[FormError] = TRIED
) -> FormError:
    """The form error with the narrowest half widths [tried, numbers] of those that cover."""
    width = np.log(half + FINEST).mean(1)
    covers = inside.mean(1) >= COVERED
    return tried[int(np.where(covers, width, np.inf).argmin() if covers.any() else width.argmax())]


def covered(of: Sequence[tuple[Number, FormError]]) -> tuple[Figure, float]:
    """Share of numbers inside their intervals, and the median half width [prior scales]."""
    inside = [abs(n.z - n.true) <= n.half_width(form) for n, form in of]
    return share(inside), statistics.median(n.half_width(form) for n, form in of)


def intervals(entries: Sequence[Entry], form: FormError | None = None) -> str:
    """A table in Markdown: coverage by a form error, or by that of all other groups."""
    of = numbers(entries)
    lines = [
        "| 95 % interval by | truth inside | median half width [prior scales] |",
        "|---|---|--:|",
    ]
    if not of:
        return "\n".join(lines)
    ways = {
        "form error" if form else "form error of other groups": (
            [(n, form) for n in of] if form else left_out(of)
        ),
        "chance alone": [(n, FormError(1.0, 0.0, 0.0)) for n in of],
        "all that remains": [(n, FormError(1.0, 0.0, 1.0)) for n in of],
    }
    for name, given in ways.items():
        inside, width = covered(given)
        between = f"{100 * inside.low:.0f} to {100 * inside.high:.0f}"
        lines.append(
            f"| {name} | {100 * inside.value:.0f} % ({between}) of {inside.count} | {width:.2f} |"
        )
    return "\n".join(lines)
