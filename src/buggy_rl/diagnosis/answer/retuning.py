"""The other null hypothesis: the simulator with all its own parameters fitted."""

from collections.abc import Callable
from dataclasses import replace

from torchrl.envs import EnvBase

from buggy_rl.diagnosis.answer.named_effect import NamedEffect, Value, sentence
from buggy_rl.diagnosis.config import SearchConfig
from buggy_rl.diagnosis.repair.proof import Proof
from buggy_rl.diagnosis.run.case import DiagnosisCase, Retuned
from buggy_rl.diagnosis.search.candidate import Effects
from buggy_rl.diagnosis.search.posterior import NORMAL, Posterior
from buggy_rl.estimation.body import body_of, implausible
from buggy_rl.estimation.evidence import cross_validated
from buggy_rl.estimation.gauss_newton import Fit, Problem, fitted
from buggy_rl.estimation.hypothesis import OWN, Hypothesis

CERTAINLY = 0.95  # [-] that a number has moved by more than `certain` standard deviations
ROUNDS, ITERATIONS = 3, 4  # of the fit; between rounds the dispersion is estimated anew


def left_open(posterior: Posterior, named: Effects, proof: Proof) -> bool:
    """Whether parameters of the simulator may be off: it is re-tuned then, and searched again."""
    unsure = not posterior.decided(named) and proof.prefers_retuning
    return posterior.says == "unknown" or unsure


def retuned(case: DiagnosisCase, progress: Callable[[str], None] = lambda _: None) -> Retuned:
    """Fits all parameters that the simulator declares, from what they are."""
    problem, rules = case.problem, case.criteria.rules
    progress(f"re-tuning {len(problem.library.parameters)} parameters of the simulator's own")
    problem, best = tuned(problem, ROUNDS, ITERATIONS, rules.expected_left)
    [known] = cross_validated(problem, [best], case.criteria.group)
    fit = Hypothesis(best.effects, best.coordinates, best.vector)
    return Retuned(fit, known.covariance)


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


def wrong_parameters(tuned: Retuned, rules: SearchConfig, simulator: EnvBase) -> list[NamedEffect]:
    """Parameters that have certainly moved, the farthest first; their gain is still open.

    Args:
        tuned: All parameters of the simulator.
        rules: From which distance a parameter has moved.
        simulator: As it was given; what its car cannot be is said of a parameter.
    """
    odd = implausible(tuned.values, body_of(simulator))
    return [
        replace(n, sentence=f"{n.sentence} ({odd[name]})") if name in odd else n
        for n in _moved(tuned, rules)
        for name in n.parameters
    ]


def _moved(tuned: Retuned, rules: SearchConfig) -> list[NamedEffect]:
    """Parameters that have certainly moved, by themselves or apart from their other side's."""
    fit = tuned.fit
    spread = tuned.covariance.diagonal().clamp_min(0.0).sqrt()
    apart = _apart(tuned, rules)
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


def _apart(tuned: Retuned, rules: SearchConfig) -> set[int]:
    """Indices of parameters of a left and a right side of which one has certainly moved.

    What turns a car as much to both sides, such as its mass, leaves each side's number open, but
    not the difference of the two.
    """
    fit, covariance = tuned.fit, tuned.covariance
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
