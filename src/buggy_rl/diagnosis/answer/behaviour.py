"""What the car does otherwise whatever is to blame, and where the repair is wrong in form."""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from buggy_rl.core.longitudinal import declared_by
from buggy_rl.diagnosis.answer.step_tests import Driven, Quantity, step_tests
from buggy_rl.diagnosis.residuals import CONDITIONS, READINGS, drive_features
from buggy_rl.diagnosis.run.case import DiagnosisCase, Retuned
from buggy_rl.diagnosis.search.posterior import NORMAL, FormError, shipped
from buggy_rl.diagnosis.search.result import SearchResult
from buggy_rl.estimation.gauss_newton import Problem
from buggy_rl.estimation.hypothesis import Hypothesis
from buggy_rl.estimation.segments import CHANNELS

SAMPLES = 16  # of the parameters' joint distribution
RELEVANT = 0.05  # [-] share of a quantity's size by which it must differ to be said
FINEST = 1e-3  # [s, 1/m, m/s^2] size below which no quantity is taken for known exactly; chosen


@dataclass(frozen=True)
class Behaviour:
    """A quantity of step tests, of the simulator as given and of the repaired one."""

    name: str
    words: str
    unit: str
    given: float
    value: float
    low: float
    high: float
    """Bounds of the 95 % interval of the repaired simulator's value."""
    differs: bool
    """Whether the simulator as given is outside the interval by more than does not matter."""

    def line(self) -> str:
        """The difference in words."""
        digits = 2 if self.unit == "s" else 3
        value, low, high, given = (
            f"{v:.{digits}g}" if self.unit != "s" else f"{1000 * v:.0f}"
            for v in (self.value, self.low, self.high, self.given)
        )
        unit = "ms" if self.unit == "s" else self.unit
        return f"{self.words}: car {value} {unit} ({low} to {high}), simulator {given} {unit}"

    def to_dict(self) -> dict[str, Any]:
        """Makes its entry in `diagnosis.json`."""
        return asdict(self)


@dataclass(frozen=True)
class Tested:
    """A quantity of step tests as simulated, before its form error is added."""

    quantity: Quantity
    given: float
    value: float
    spread: float
    """Standard deviation by the joint distribution of the numbers of the best description."""
    apart: float
    """Largest distance of another leading hypothesis."""

    @property
    def size(self) -> float:
        """Size of which a form error is a share; no less than what matters: no interval is 0."""
        return max(abs(self.value), abs(self.given), self.quantity.least, FINEST)

    def half_width(self, form: FormError) -> float:
        """Half width of its 95 % interval."""
        return NORMAL * form.sd(self.size, self.spread, 0.0) + self.apart


def answer_section(case: DiagnosisCase, found: SearchResult) -> Mapping[str, Any]:
    """The part of the answer that says what the car does otherwise, and what is left of it."""
    return {"behaviours": behaviours(case, found), "form": form_faults(case.problem, found)}


def behaviours(case: DiagnosisCase, found: SearchResult) -> list[Behaviour]:
    """Quantities that were driven, of the simulator as given and with what was found.

    An interval holds what the numbers of the best description may be, the form error that such
    quantities have beside (`Calibration.step_error`), and the other leading hypotheses.

    Args:
        case: Recordings and simulator.
        found: What the search came to.
    """
    form = shipped().step_error
    return [_compared(t, t.half_width(form)) for t in step_values(case, found)]


def step_values(case: DiagnosisCase, found: SearchResult) -> list[Tested]:
    """Quantities that were driven and that the tests show; the arguments are `behaviours`'."""
    problem, simulation, library = case.problem, case.given, case.as_given
    described = found.described
    neutral, best = library.hypothesis(()), case.about_given(described.fit)
    covariance = described.cross_validated.covariance
    if case.retuned_from is not None:
        covariance = _joint(covariance, case.tuned)
    others = [
        case.about_given(found.tried[key].fit)
        for key in found.most_probable
        if key != described.key
    ]
    samples = [(best, vector) for vector in _sampled(best, covariance)]
    rows = [(neutral, neutral.vector), *samples, *((h, h.vector) for h in others)]
    driven = driven_of(case)
    steps = step_tests(simulation, library, rows, driven, problem.segments.dt)
    given, repaired, rivals = steps.split([1, len(samples), len(others)])
    values = repaired[0]
    spread = torch.stack([_spread(column) for column in repaired[1:].unbind(-1)])
    apart = torch.zeros_like(spread)
    if others:  # an interval that holds whichever of them is true
        apart = (rivals - values).abs().amax(0).nan_to_num(math.inf)
    columns = (part.tolist() for part in (given[0], values, spread, apart))
    return [
        t
        for t in map(Tested, driven.quantities, *columns)
        if t.quantity.name in driven.shown and math.isfinite(t.given + t.value + t.spread + t.apart)
    ]


def driven_of(case: DiagnosisCase) -> Driven:
    """Speeds and commands that the recordings of a case show."""
    return Driven.of(case.problem.segments, declared_by(case.given.make(1)).rest)


def differing(found: Sequence[Behaviour]) -> list[Behaviour]:
    """Quantities that differ, the clearest first."""
    return sorted((b for b in found if b.differs), key=_clearness, reverse=True)


def _clearness(b: Behaviour) -> float:
    return abs(b.value - b.given) / max(b.high - b.low, 1e-9)


def _spread(values: Tensor) -> Tensor:
    """Standard deviation of values [S]; unknown where most tests do not show it."""
    shown = values[values.isfinite()]
    return shown.std() if 2 * len(shown) > len(values) else values.new_tensor(math.inf)


def _compared(of: Tested, half_width: float) -> Behaviour:
    quantity, given, value = of.quantity, of.given, of.value
    low, high = value - half_width, value + half_width
    least = quantity.least or RELEVANT * max(abs(given), abs(value))
    return Behaviour(
        quantity.name,
        quantity.words,
        quantity.unit,
        given,
        value,
        low,
        high,
        differs=max(low - given, given - high) > least,
    )


def _joint(effects: Tensor, tuned: Retuned | None) -> Tensor:
    """Covariance [P, P] of effects, the simulator's own parameters and the clock, the last.

    Both were fitted one after the other, so what they share is unknown and taken for nothing.
    """
    own = effects.new_zeros(0, 0) if tuned is None else tuned.covariance[:-1, :-1]
    return torch.block_diag(effects[:-1, :-1], own, effects[-1:, -1:])


def _sampled(hypothesis: Hypothesis, covariance: Tensor) -> Tensor:
    """Vectors [1 + SAMPLES, P]: the fit's own, and others that the recordings allow."""
    values, basis = torch.linalg.eigh(0.5 * (covariance + covariance.mT).double())
    generator = torch.Generator().manual_seed(0)
    drawn = torch.randn(SAMPLES, len(values), generator=generator, dtype=torch.float64)
    moved = drawn @ (basis * values.clamp_min(0.0).sqrt()).mT
    return torch.cat(
        [hypothesis.vector.unsqueeze(0), hypothesis.bounded(hypothesis.vector + moved)]
    )


BINS = 5  # of a condition, with equal shares of the instants
MOST = 3  # faults that are reported
SIGNIFICANT = 3.0  # [standard errors] from which a median is not taken for chance
NOTICED = 1.0  # [noise standard deviations] from which it is worth a sentence
BINNED = ("vx", "steering", "throttle", "steering_rate", "lateral_acceleration", "elapsed")
QUARTILES = torch.tensor([0.25, 0.5, 0.75], dtype=torch.float64)


@dataclass(frozen=True)
class FormFault:
    """A velocity that the repaired simulator gets wrong to one side in one condition."""

    channel: str
    condition: str
    low: float
    high: float
    """Bounds of the condition."""
    median: float
    """Simulated minus measured, median over segments of each one's mean [m/s or rad/s]."""

    def line(self) -> str:
        """The fault in words."""
        reading, condition = READINGS[self.channel], CONDITIONS[self.condition]
        words, of = reading.fault or reading.words, condition.unit
        side = "too high" if self.median > 0 else "too low"
        bounds = f"{self.low:.2g} to {self.high:.2g}" + (f" {of}" if of else "")
        return (
            f"{words} {abs(self.median):.2g} {reading.unit} {side} (median) at "
            f"{condition.words} {bounds}"
        )

    def to_dict(self) -> dict[str, Any]:
        """Makes its entry in `diagnosis.json`."""
        return asdict(self)


def form_faults(problem: Problem, found: SearchResult) -> list[FormFault]:
    """Form faults of the best description, the largest first; one for each channel at most."""
    best = found.described.fit
    settings = problem.library.settings([(best, best.vector)])
    residual = problem.simulation.residuals(problem.segments, settings)[0]  # (N, K, 6)
    instants = problem.simulation.instants(problem.segments)
    noise = problem.noise.sd[3:].tolist()
    conditions = drive_features(problem.segments, instants)
    result = []
    for index, channel in enumerate(CHANNELS):
        off = residual[..., 3 + index].double()
        faults = [
            (abs(fault.median) / noise[index], fault)
            for name in BINNED
            for fault in _off(off, conditions[name].double(), channel, name, noise[index])
        ]
        result += sorted(faults, key=lambda item: -item[0])[:1]
    return [fault for _, fault in sorted(result, key=lambda item: -item[0])][:MOST]


def _off(off: Tensor, condition: Tensor, channel: str, name: str, noise: float) -> list[FormFault]:
    """Bins of a condition [N, K] in which a residual [N, K] is off to one side."""
    edges = np.unique(np.quantile(condition.numpy(), np.linspace(0, 1, BINS + 1)))
    found = []
    for low, high in itertools.pairwise(edges):
        inside = (condition >= low) & (condition <= high) & off.isfinite()
        count = inside.sum(-1)
        of_segment = torch.where(inside, off, 0.0).sum(-1)[count > 0] / count[count > 0]
        if len(of_segment) < BINS:
            continue
        # Instants of a segment share its start: segments are the independent samples.
        first, median, third = of_segment.quantile(QUARTILES).tolist()
        # 1.253 sd / sqrt(n) is the standard error of a median; the quartiles are 1.349 sd apart.
        error = 1.253 * (third - first) / 1.349 / math.sqrt(len(of_segment))
        if abs(median) > max(SIGNIFICANT * error, NOTICED * noise):
            found.append(FormFault(channel, name, float(low), float(high), median))
    return found
