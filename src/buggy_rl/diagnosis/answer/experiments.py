"""Which manoeuvre to drive next: the one that most probably decides between what is left open.

Each leading hypothesis is taken for the truth, weighted by its probability. What it would have
recorded of a manoeuvre is simulated; the others take other numbers as far as what was driven lets
them; noise of the size that the search came to is drawn; and the calibrated posterior is computed
anew with these drives as further held-out blocks. The decision rate of a manoeuvre is how often the
truth then has a probability of at least `SURE`. Beside it stands what was hardly driven at all.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import torch
from torch import Tensor

from buggy_rl.core.vehicle import Similarity, wrap_angle
from buggy_rl.diagnosis.answer.manoeuvres import HEADINGS, MANOEUVRES, TIMES, simulated, trusted
from buggy_rl.diagnosis.run.case import DiagnosisCase
from buggy_rl.diagnosis.search.candidate import Candidate, Effects
from buggy_rl.diagnosis.search.case_evidence import CaseEvidence, HypothesisEvidence
from buggy_rl.diagnosis.search.posterior import SURE, posterior
from buggy_rl.diagnosis.search.result import SearchResult
from buggy_rl.estimation.evidence import misfit, typical
from buggy_rl.estimation.gauss_newton import Fit, Problem
from buggy_rl.estimation.noise_model import noise_model
from buggy_rl.estimation.segments import Segments, cut_segments

SUGGESTED = 0.8  # [-] decision rate from which a manoeuvre is suggested
SAMPLES = 32  # of the noise, for each manoeuvre and truth
LEAST = 1e-9  # [prior scales^2] variance of a parameter, at least


@dataclass(frozen=True)
class DecisionRate:
    """How probably a manoeuvre decides."""

    manoeuvre: str
    """Name of the manoeuvre."""
    words: str
    """Words for a driver."""
    rate: float
    """Probability with which the true one of `between` is decided afterwards."""
    expected: float
    """Mean probability that the true one has afterwards; ranks equal rates."""
    between: tuple[Effects, ...]
    """The leading hypotheses, the most probable first."""

    def to_dict(self) -> dict[str, Any]:
        """Makes its entry in `diagnosis.json`."""
        return asdict(self)

    def line(self) -> str:
        """Says what to drive, and why."""
        names = " and ".join("+".join(effects) or "nothing" for effects in self.between)
        return (
            f"{self.words}, {TIMES} times, each facing another way (expected to decide between "
            f"{names} with a probability of {self.rate:.0%})"
        )


def answer_section(case: DiagnosisCase, found: SearchResult) -> Mapping[str, Any]:
    """The part of the answer that says what to drive next, and what was hardly driven."""
    rates = decision_rates(case.problem, found) if case.budget.experiments else []
    return {
        "manoeuvres": rates,
        "suggest": manoeuvre_suggestions(rates),
        "weak": weak(case.problem.segments, case.similarity),
    }


def manoeuvre_suggestions(rates: Sequence[DecisionRate]) -> list[str]:
    """The manoeuvre that most probably decides, as a line; none where none reaches `SUGGESTED`."""
    return [best.line() for best in rates[:1] if best.rate >= SUGGESTED]


def decision_rates(problem: Problem, found: SearchResult) -> list[DecisionRate]:
    """Decision rates of every manoeuvre, the highest first; none where nothing is left open.

    Args:
        problem: What was driven, with the noise model and dispersion that the search came to.
        found: What it found.
    """
    between = found.most_probable
    if len(between) < 2 or found.posterior.decided(between[0]):
        return []
    candidates = [found.tried[effects] for effects in between]
    weights = [found.posterior.sets[effects] for effects in between]
    rates = torch.stack([_rates(problem, found, truth, candidates) for truth in candidates])
    share = torch.tensor(weights, dtype=rates.dtype) / sum(weights)
    mean = torch.einsum("h,hmk->mk", share, rates).tolist()
    every = [
        DecisionRate(m.name, m.words, rate, expected, tuple(between))
        for m, (rate, expected) in zip(MANOEUVRES, mean, strict=True)
    ]
    return sorted(every, key=lambda r: (-r.rate, -r.expected))


@dataclass(frozen=True)
class _Manoeuvre:
    """What hypotheses leave of a manoeuvre as the truth would have it recorded, without noise."""

    drive: Tensor
    """[n] number of the simulated drive that a segment is of."""
    residuals: Mapping[Effects, Tensor]
    """Hypothesis -> whitened residuals [n, D]."""


def _rates(
    problem: Problem, found: SearchResult, truth: Candidate, candidates: Sequence[Candidate]
) -> Tensor:
    """Decision rate and mean probability [M, 2] of every manoeuvre if a candidate is the truth.

    Sets that are a candidate in other words (`limits`) are weighed too, and count as that one.
    """
    known = [*candidates, *([] if found.null in candidates else [found.null])]
    named = {candidate.key for candidate in candidates}
    known += [found.tried[effects] for effects, other in found.same.items() if other in named]
    generator = torch.Generator().manual_seed(0)
    rates = [
        _rate(problem, found, truth.key, manoeuvre, generator)
        for manoeuvre in _rolled_out(problem, truth, known)
    ]
    return torch.tensor(rates, dtype=torch.float64)


def _rolled_out(problem: Problem, truth: Candidate, known: Sequence[Candidate]) -> list[_Manoeuvre]:
    """Rolls out every manoeuvre."""
    recordings, outside = simulated(problem, truth)
    segments = cut_segments(recordings, problem.segments.horizon * problem.segments.dt, 1.0)
    settings = problem.library.settings([(truth.fit, truth.fit.vector)])
    noise = noise_model(
        problem.simulation, segments, settings, problem.noise.standing, problem.segments
    )
    there = replace(problem, segments=segments, noise=noise)
    true, *rolled = there.rolled_out([candidate.fit for candidate in (truth, *known)])
    fits, kept = there.linearised(rolled), trusted(problem.segments, segments, outside)
    result = []
    for number in range(len(MANOEUVRES)):
        rows = (segments.recording // HEADINGS == number) & kept
        residuals = {
            candidate.key: refitted(true[rows], fit[rows], candidate, problem.dispersion)
            for candidate, fit in zip(known, fits, strict=True)
        }
        result.append(_Manoeuvre(segments.recording[rows] % HEADINGS, residuals))
    return result


def refitted(truth: Fit, fit: Fit, candidate: Candidate, dispersion: float) -> Tensor:
    """What a hypothesis leaves [n, D] of what the truth predicts, to first order.

    With d the difference of both, J its derivatives and P the precision of its numbers by what was
    driven, d - J (P + w J^T J)^-1 w J^T d, w the drives that each simulated one stands for over
    phi.
    """
    assert fit.jacobian is not None
    own = torch.eye(len(fit.vector), dtype=torch.float64)
    precision = torch.linalg.inv(candidate.cross_validated.covariance + LEAST * own)
    difference = (fit.whitened - truth.whitened).double()
    jacobian, weight = fit.jacobian.double(), TIMES / HEADINGS / dispersion
    flat = jacobian.flatten(0, 1)  # (n D, P)
    score = weight * flat.mT @ difference.flatten()
    moved = torch.linalg.solve(precision + weight * flat.mT @ flat, score)
    return (difference - jacobian @ moved).nan_to_num(0.0)


def _rate(
    problem: Problem,
    found: SearchResult,
    truth: Effects,
    manoeuvre: _Manoeuvre,
    generator: torch.Generator,
) -> tuple[float, float]:
    """How often the truth is decided once a manoeuvre is driven, and its mean probability then."""
    assert found.observed is not None  # what a search came to has what was seen of it
    if not len(manoeuvre.drive):
        return 0.0, 0.0
    repeats = TIMES // HEADINGS
    shape = (SAMPLES, repeats, *manoeuvre.residuals[truth].shape)
    noise = torch.randn(shape, generator=generator, dtype=torch.float64)
    noise = math.sqrt(problem.dispersion) * noise
    squares = {
        effects: (noise + residual).square().sum(-1)  # (SAMPLES, repeats, n)
        for effects, residual in manoeuvre.residuals.items()
    }
    sure = []
    for k in range(SAMPLES):
        drawn = {effects: square[k] for effects, square in squares.items()}
        after = posterior(with_drives(problem, found.observed, drawn, manoeuvre))
        sure.append(after.merged(found.same).least_sure(truth))
    return sum(p >= SURE for p in sure) / SAMPLES, sum(sure) / SAMPLES


def with_drives(
    problem: Problem,
    observed: CaseEvidence,
    squares: Mapping[Effects, Tensor],
    manoeuvre: _Manoeuvre,
) -> CaseEvidence:
    """What was observed of some hypotheses, with further drives held out.

    Args:
        problem: Dispersion and length of a residual.
        observed: Of the recordings so far.
        squares: Hypothesis -> |W e|^2 [repeats, n] of the further segments.
        manoeuvre: Which drives they are of.
    """
    kept = [h for h in observed.hypotheses if h.effects in squares]
    hypotheses = tuple(_with(problem, observed, h, squares[h.effects], manoeuvre) for h in kept)
    [first] = [h.excess for h in hypotheses if not h.effects]
    return replace(observed, hypotheses=hypotheses, first=first)


def _with(
    problem: Problem,
    observed: CaseEvidence,
    hypothesis: HypothesisEvidence,
    square: Tensor,
    manoeuvre: _Manoeuvre,
) -> HypothesisEvidence:
    loss = problem.noise.loss(square, problem.dispersion)
    blocks = torch.stack([loss[:, manoeuvre.drive == d].sum(-1) for d in range(HEADINGS)]).flatten()
    segments, more = observed.segments, square.numel()
    standardised = square.flatten() / problem.noise.dimension
    excess, median = misfit(standardised) - 1, typical(standardised)
    evidence = hypothesis.evidence
    # Of the two medians, by their segments: those of the recordings are not among what is observed.
    return replace(
        hypothesis,
        held_out=(*hypothesis.held_out, *blocks.tolist()),
        excess=(segments * hypothesis.excess + more * excess) / (segments + more),
        typical=(segments * hypothesis.typical + more * median) / (segments + more),
        evidence=replace(evidence, log_evidence=evidence.log_evidence - float(loss.sum())),
    )


BUGGY = Similarity()
SHOWN = 0.03  # [-] share of the time from which a condition counts as driven
SECTORS = 8  # sectors of the heading
FAST, SLOW, ROLLING, CRAWLING = 2.0, 1.0, 0.5, 0.1  # [m/s] of the buggy; chosen
QUICK = 5.0  # [1/s] change of the steering command that counts as quick; chosen


def weak(segments: Segments, similarity: Similarity = BUGGY) -> list[str]:
    """A line for each condition that was hardly or never driven, with the effects that it hides.

    Args:
        segments: What was driven.
        similarity: Of the car to the buggy, for which the speeds were chosen.
    """
    fast, slow, rolling, crawling = (similarity.speed * v for v in (FAST, SLOW, ROLLING, CRAWLING))
    rows = slice(segments.start, None)
    vx, yaw_rate = segments.smooth_velocity[:, rows, 0], segments.smooth_velocity[:, rows, 2]
    throttle, steering = segments.action[:, rows].unbind(-1)
    drive, lateral = (throttle + 1) / 2, (vx * yaw_rate).abs()
    yaw = wrap_angle(segments.smooth_pose[:, rows, 2])
    heading = ((yaw + torch.pi) / (2 * torch.pi) * SECTORS).long().clamp(0, SECTORS - 1)
    seen = torch.bincount(heading.flatten(), minlength=SECTORS) / heading.numel()
    checks = (
        ("more than 0.6 of full drive", drive > 0.6, "motor_power_limit, top_speed"),
        (f"above {fast:g} m/s", vx > fast, "aerodynamic_drag, top_speed"),
        (
            f"below {slow:g} m/s",
            (vx < slow) & (vx > crawling),
            "rolling_resistance, throttle_deadband",
        ),
        (
            "coasting without drive",
            (drive < 0.05) & (vx > rolling),
            "rolling_resistance, viscous_drag, aerodynamic_drag apart from the throttle's effects",
        ),
        ("hard left turns", steering > 0.6, "steering_asymmetry"),
        ("hard right turns", steering < -0.6, "steering_asymmetry"),
        ("bends near the limit of grip (5 m/s^2)", lateral > 5.0, "tire_grip, grip_balance"),
        (
            "quick steering",
            segments.action[:, rows, 1].diff(dim=1).abs() > QUICK * segments.dt,
            "steering_dead_time from steering_lag, steering_rate_limit, steering_backlash",
        ),
        ("going straight", (steering.abs() < 0.1) & (vx > rolling), "steering_offset"),
    )
    found = [
        f"{what} hardly driven: hides {hides}"
        for what, mask, hides in checks
        if float(mask.double().mean()) < SHOWN
    ]
    if int((seen > 0.02).sum()) < SECTORS:
        found.append("not all directions driven: hides floor_slope, wind")
    if float(torch.maximum(segments.elapsed, segments.session).max()) < 30.0:
        found.append("less than 30 s of one recording: hides battery_sag, thermal_foldback")
    return found
