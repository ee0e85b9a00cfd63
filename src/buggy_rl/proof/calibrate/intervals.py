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
from functools import cache
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from buggy_rl.core.files import rounded
from buggy_rl.diagnosis.answer.behaviour import driven_of, step_values
from buggy_rl.diagnosis.answer.named_effect import NORMAL
from buggy_rl.diagnosis.answer.step_tests import step_tests
from buggy_rl.diagnosis.run.case import DiagnosisCase as Opened
from buggy_rl.diagnosis.search.case_evidence import DIGITS, HypothesisEvidence
from buggy_rl.diagnosis.search.joint import JointSearch
from buggy_rl.diagnosis.search.observed import concluded
from buggy_rl.diagnosis.search.posterior import FormError
from buggy_rl.effects import effect_class
from buggy_rl.estimation.hypothesis import Library
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.proof.calibrate.calibration import group
from buggy_rl.proof.cases.case import RATES, Case
from buggy_rl.proof.cases.drives import plant_of, plant_parameters
from buggy_rl.proof.cases.equivalents import expected
from buggy_rl.proof.ledger import Entry
from buggy_rl.proof.score.figures import Figure, cell, share, written

CHANCE = (1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0)  # tried
ALWAYS = (0.0, 0.01, 0.02, 0.03, 0.05, 0.08, 0.12, 0.17, 0.24, 0.34)  # tried
REMAINS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.7, 1.0)  # tried
TRIED = [FormError(*of) for of in product(CHANCE, ALWAYS, REMAINS)]
STEPS_TRIED = [FormError(chance, always, 0.0) for chance in CHANCE for always in ALWAYS if always]
CHANCE_ALONE = FormError(1.0, 0.0, 0.0)
COVERED = 0.95
REDEFINED = {"cornering_drag"}
"""Effects whose equation has changed: numbers in lines from before step tests were kept are of
another one. Until then cornering_drag was -c |vx r|."""
FINEST = 1e-6  # [prior scales] added to half widths before a logarithm


@dataclass(frozen=True)
class Number:
    """A number that was said, and what it is in truth: of a true set, or of a step test."""

    value: float
    """[prior scales] of a fitted number, in its own unit of a step test; so are the others."""
    true: float
    size: float
    """Size that form errors are shares of."""
    spread: float
    """Standard deviation by leaving out blocks."""
    group: str
    share: float = 0.0
    """What remains over what its effect closes."""
    apart: float = 0.0
    """Spread of the other leading hypotheses about it."""
    name: str = ""
    """Name of a step test's quantity."""

    def half_width(self, form: FormError) -> float:
        """Half width of its 95 % interval."""
        return NORMAL * form.sd(self.size, self.spread, self.share) + self.apart

    def inside(self, form: FormError) -> bool:
        """Whether the truth is in the interval."""
        return abs(self.value - self.true) <= self.half_width(form)


def scored_numbers(entries: Sequence[Entry]) -> list[Number]:
    """Numbers of all cases whose true set was fitted, and has a number in truth."""
    found = []
    for entry in entries:
        if not entry.case.truth or entry.case.unknown:
            continue
        own = entry.seen.of(entry.case.truth)
        found += [] if own is None else _of(entry, own)
    return found


def _of(entry: Entry, own: HypothesisEvidence) -> list[Number]:
    case, seen = entry.case, entry.seen
    names = [(e, p) for e, values in own.values.items() if e for p in values]
    found = []
    for (effect, name), z, sd in zip(names, own.z, own.sd, strict=False):  # the clock is last
        value = expected(case, effect).get(name)
        today = effect not in REDEFINED or entry.steps is not None
        if value is not None and today:
            [parameter] = [p for p in effect_class(effect).declared if p.name == name]
            true = float(parameter.coordinate(value))
            closed = seen.without(own, effect).excess - own.excess
            share = seen.usual.remaining(own.excess, closed)
            found.append(Number(z, true, z, sd, group(case), share))
    return found


def form_error(of: Sequence[Number], tried: Sequence[FormError] = TRIED) -> FormError:
    """The narrowest of those tried that covers; the widest where none does."""
    return narrowest(*_tried(of, tried), tried)


def left_out(
    of: Sequence[Number], tried: Sequence[FormError] = TRIED
) -> list[tuple[Number, FormError]]:
    """Each number with the form error of all other groups."""
    half, inside = _tried(of, tried)
    group_of = np.array([n.group for n in of])
    forms: dict[str, FormError] = {}
    for name in {*group_of}:
        others = group_of != name if (group_of != name).any() else slice(None)
        forms[name] = narrowest(half[:, others], inside[:, others], tried)
    return [(n, forms[n.group]) for n in of]


def _tried(
    of: Sequence[Number], tried: Sequence[FormError]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Half widths [tried, numbers], and whether the truth is inside."""
    value, true, size, spread, share, apart = (
        np.array([getattr(n, name) for n in of])
        for name in ("value", "true", "size", "spread", "share", "apart")
    )
    half = NORMAL * np.stack([form.sd(size, spread, share) for form in tried]) + apart
    return half, np.abs(value - true) <= half


def narrowest(
    half: NDArray[np.float64], inside: NDArray[np.bool_], tried: Sequence[FormError]
) -> FormError:
    """The form error with the narrowest half widths [tried, numbers] of those that cover."""
    width = np.log(half + FINEST).mean(1)
    covers = inside.mean(1) >= COVERED
    return tried[int(np.where(covers, width, np.inf).argmin() if covers.any() else width.argmax())]


def covered(of: Sequence[tuple[Number, FormError]]) -> tuple[Figure, float]:
    """Share of numbers inside their intervals, and the median half width."""
    return share([n.inside(form) for n, form in of]), statistics.median(
        n.half_width(form) for n, form in of
    )


def intervals(entries: Sequence[Entry], form: FormError | None = None) -> str:
    """A table in Markdown: coverage by a form error, or by that of all other groups."""
    of = scored_numbers(entries)
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
        "chance alone": [(n, CHANCE_ALONE) for n in of],
        "all that remains": [(n, FormError(1.0, 0.0, 1.0)) for n in of],
    }
    for name, given in ways.items():
        inside, width = covered(given)
        lines.append(f"| {name} | {cell(inside)} | {width:.2f} |")
    return "\n".join(lines)


def has_truth(case: Case) -> bool:
    """Whether the step tests of a case's plant are what a sensor on it would show."""
    return not (
        case.camera or case.disturbances or case.nuisance == "stamps" or case.rate != RATES[-1]
    )


def step_quantities(ready: Opened, found: JointSearch, case: Case) -> list[dict[str, Any]]:
    """Quantities of a case, as a line of a ledger has them; none where the plant has no truth."""
    if not has_truth(case):
        return []
    result = concluded(ready.criteria, found)
    driven, dt = driven_of(ready), ready.problem.segments.dt
    plant = cache(lambda cars: plant_of(case, cars, case.faults, plant_parameters(case)))
    nothing = Library([]).hypothesis(())
    rows = [(nothing, nothing.vector)]
    [true] = step_tests(Simulation(plant), Library([]), rows, driven, dt).tolist()
    of_car = dict(zip((q.name for q in driven.quantities), true, strict=True))
    lines = [
        {
            "name": t.quantity.name,
            "value": t.value,
            "size": t.size,
            "spread": t.spread,
            "apart": t.apart,
            "true": of_car[t.quantity.name],
        }
        for t in step_values(ready, result)
    ]
    return rounded([line for line in lines if np.isfinite(line["true"])], DIGITS)


def steps(entries: Sequence[Entry]) -> list[Number]:
    """Quantities of all cases whose line has them."""
    return [Number(**line, group=group(e.case)) for e in entries for line in e.steps or ()]


def step_intervals(entries: Sequence[Entry], form: FormError | None = None) -> str:
    """A table in Markdown: coverage by quantity, by a form error or by that of all other groups."""
    of = steps(entries)
    lines = ["| step test | truth inside | with the numbers' spread alone |", "|---|---|---|"]
    if not of:
        return "\n".join([*lines, "| none in these ledgers | | |"])
    given = [(n, form) for n in of] if form else left_out(of, STEPS_TRIED)
    for name in ("all", *dict.fromkeys(n.name for n in of)):
        own = [(n, law) for n, law in given if name in ("all", n.name)]
        inside, without = covered(own)[0], covered([(n, CHANCE_ALONE) for n, _ in own])[0]
        lines.append(f"| {name} | {written(inside, digits=0)} | {cell(without)} |")
    return "\n".join(lines)
