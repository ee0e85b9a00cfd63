"""The other null hypothesis: the simulator with all its own parameters fitted."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from buggy_rl.diagnosis.answer.named_effect import NORMAL, NamedEffect, Value, sentence
from buggy_rl.diagnosis.config import SearchConfig
from buggy_rl.diagnosis.run.case import DiagnosisCase
from buggy_rl.diagnosis.search.candidate import Candidate
from buggy_rl.estimation.body import body_of, implausible
from buggy_rl.estimation.evidence import cross_validated
from buggy_rl.estimation.gauss_newton import Fit, Problem, fitted
from buggy_rl.estimation.hypothesis import OWN, Hypothesis

CERTAINLY = 0.95  # [-] that a number has moved by more than `certain` standard deviations
ROUNDS, ITERATIONS = 3, 4  # of the fit; between rounds the dispersion is estimated anew


@dataclass(frozen=True)
class Retuned:
    """A simulator whose own parameters were fitted to the recordings."""

    values: dict[str, float]
    """Values of all its parameters."""
    wrong: list[NamedEffect]
    """Parameters that have certainly moved, the farthest first; their gain is still open."""
    covariance: Tensor
    """[P, P] of all their normalised values, in the order of the simulator's declaration."""


def retuned(case: DiagnosisCase, progress: Callable[[str], None] = lambda _: None) -> Retuned:
    """Fits all parameters that the simulator declares, from what they are."""
    problem, rules = case.problem, case.criteria.rules
    progress(f"re-tuning {len(problem.library.parameters)} parameters of the simulator's own")
    problem, best = tuned(problem, ROUNDS, ITERATIONS, rules.expected_left)
    [known] = cross_validated(problem, [best], case.criteria.group)
    values = {n: v for effect, ps in best.values().items() if effect for n, v in ps.items()}
    # The clock is the last coordinate.
    odd = implausible(values, body_of(problem.simulation.make(1)))
    wrong = [
        replace(n, sentence=f"{n.sentence} ({odd[name]})") if name in odd else n
        for n in _wrong(Candidate(best, known), rules)
        for name in n.parameters
    ]
    return Retuned(values, wrong, known.covariance[:-1, :-1])


def tuned(
    problem: Problem, rounds: int, iterations: int, expected_left: float
) -> tuple[Problem, Fit]:
    """Fits all declared parameters, the dispersion estimated anew before each round."""
    own = [OWN + name for name in problem.library.parameters]
    [best] = fitted(problem, [problem.library.hypothesis(own)], 0)
    for _ in range(rounds):
        typical = float((best.square / problem.noise.dimension).median())
        problem = replace(problem, dispersion=max(1.0, expected_left * typical))
        [best] = fitted(problem, [best], iterations)
    return problem, best


def with_own(case: DiagnosisCase, best: Hypothesis) -> Hypothesis:
    """A hypothesis about the re-tuned simulator, as one about the simulator as it was given."""
    library = case.problem.library
    own = [OWN + name for name in library.parameters]
    start = case.as_given.hypothesis((*best.effects, *own))
    tuned = {p.name: p.value for p in library.parameters.values()}
    moved = [
        float(c.parameter.coordinate(tuned[c.parameter.name]))
        for c in start.coordinates
        if c.effect in own
    ]
    vector = torch.cat([best.vector[:-1], best.vector.new_tensor(moved), best.vector[-1:]])
    return replace(start, vector=vector)


def _wrong(candidate: Candidate, rules: SearchConfig) -> list[NamedEffect]:
    """Parameters that have certainly moved, by themselves or apart from their other side's."""
    fit = candidate.fit
    spread = candidate.cross_validated.covariance.diagonal().clamp_min(0.0).sqrt()
    apart = _apart(candidate, rules)
    found: list[tuple[float, NamedEffect]] = []
    numbers = zip(fit.coordinates, fit.vector.tolist(), spread.tolist(), strict=True)
    for index, (coordinate, z, sd) in enumerate(numbers):
        moved = abs(z) >= max(rules.moved, rules.certain * sd)
        if not coordinate.effect or not (moved or index in apart):
            continue
        p = coordinate.parameter
        low, value, high = (
            min(max(float(p.value_at(z + k * NORMAL * sd)), p.lower), p.upper) for k in (-1, 0, 1)
        )
        words = sentence(coordinate.effect, {p.name: value}, p.unit, float(p.value))
        named = NamedEffect(
            name=coordinate.effect,
            kind="parameter",
            equation="",
            sentence=words if moved else f"{words}: left and right certainly differ",
            parameters={p.name: Value(value, min(low, high), max(low, high), p.unit)},
            confidence=CERTAINLY,
            held_out_gain=0.0,
            inside=(p.name,),
        )
        found.append((abs(z), named))
    return [named for _, named in sorted(found, key=lambda item: -item[0])]


def _apart(candidate: Candidate, rules: SearchConfig) -> set[int]:
    """Indices of parameters of a left and a right side of which one has certainly moved.

    What turns a car as much to both sides, such as its mass, leaves each side's number open, but
    not the difference of the two.
    """
    fit, covariance = candidate.fit, candidate.cross_validated.covariance
    index = {c.parameter.name: i for i, c in enumerate(fit.coordinates) if c.effect}
    found: set[int] = set()
    for name, left in index.items():
        right = index.get(name.replace("left", "right"), left)
        way = float(fit.vector[left] - fit.vector[right])
        variance = covariance[left, left] + covariance[right, right] - 2 * covariance[left, right]
        sd = float(variance.clamp_min(0.0).sqrt())
        if right != left and abs(way) >= max(rules.moved, rules.certain * sd):
            found |= {left, right}
    return found
