"""Coverage of the intervals of step tests, counted on development cases, and their form error.

The plant of a case is the car: its own step tests, at the speeds and commands that were driven,
are the truth of what the diagnosis says the car does. Cases with a concealed error of the sensor,
with stamps that are off or with another rate have no such truth, and cases outside the library's
physics whose disturbance is added behind the plant's back neither.

Form error of a quantity of size q: sd^2 = (chance sd_numbers)^2 + (always q)^2, the narrowest that
covers, as in `intervals`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from buggy_rl.blind_test.calibration import Entry, group
from buggy_rl.blind_test.case import RATES, Case
from buggy_rl.blind_test.drives import plant_of, plant_parameters
from buggy_rl.blind_test.intervals import ALWAYS, CHANCE, narrowest
from buggy_rl.blind_test.statistics import share
from buggy_rl.diagnosis.behaviour import driven_of, step_values
from buggy_rl.diagnosis.case import Case as Opened
from buggy_rl.diagnosis.case_evidence import rounded
from buggy_rl.diagnosis.form_error import FormError
from buggy_rl.diagnosis.joint import JointSearch
from buggy_rl.diagnosis.named_effect import NORMAL
from buggy_rl.diagnosis.observed import concluded
from buggy_rl.diagnosis.step_tests import step_tests
from buggy_rl.estimation.hypothesis import Library
from buggy_rl.estimation.rollout import Simulation

TRIED = [FormError(chance, always, 0.0) for chance in CHANCE for always in ALWAYS if always]


@dataclass(frozen=True)
class Step:
    """A quantity of a case's step tests, and what it is of the car."""

    name: str
    value: float
    size: float
    spread: float
    apart: float
    true: float
    group: str

    def half_width(self, form: FormError) -> float:
        """Of its 95 % interval, in its unit."""
        return NORMAL * form.sd(self.size, self.spread, 0.0) + self.apart

    def holds(self, form: FormError) -> bool:
        """Whether the truth is inside."""
        return abs(self.value - self.true) <= self.half_width(form)


def has_truth(case: Case) -> bool:
    """Whether the step tests of a case's plant are what a sensor on it would show."""
    return not (
        case.camera or case.disturbances or case.nuisance == "stamps" or case.rate != RATES[-1]
    )


def described(ready: Opened, found: JointSearch, case: Case) -> list[dict[str, Any]]:
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
    return rounded([line for line in lines if np.isfinite(line["true"])])


def steps(entries: Sequence[Entry]) -> list[Step]:
    """Of all cases whose line has them."""
    return [Step(**line, group=group(e)) for e in entries for line in e.get("steps", ())]


def step_error(of: Sequence[Step]) -> FormError:
    """The narrowest of `TRIED` that covers; the widest where none does."""
    half = np.array([[step.half_width(form) for step in of] for form in TRIED])
    inside = np.array([[step.holds(form) for step in of] for form in TRIED])
    return narrowest(half, inside, TRIED)


def step_intervals(entries: Sequence[Entry], form: FormError | None = None) -> str:
    """A table in Markdown: coverage by quantity, by a form error or by that of all other groups."""
    of = steps(entries)
    lines = ["| step test | truth inside | with the numbers' spread alone |", "|---|---|---|"]
    if not of:
        return "\n".join([*lines, "| none in these ledgers | | |"])
    groups = sorted({s.group for s in of})
    others = {g: form or step_error([s for s in of if s.group != g] or of) for g in groups}
    alone = FormError(1.0, 0.0, 0.0)
    for name in ("all", *dict.fromkeys(s.name for s in of)):
        own = [s for s in of if name in ("all", s.name)]
        inside, without = (
            share([s.holds(law) for s, law in zip(own, laws, strict=True)])
            for laws in ([others[s.group] for s in own], [alone] * len(own))
        )
        parts = (
            f"{100 * f.value:.0f} % ({100 * f.low:.0f} to {100 * f.high:.0f})"
            for f in (inside, without)
        )
        lines.append(f"| {name} | {' | '.join(parts)} of {inside.count} |")
    return "\n".join(lines)
