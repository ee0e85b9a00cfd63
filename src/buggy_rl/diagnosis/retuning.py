"""The other null: the simulator with all its own parameters fitted, before physics is missed."""

from collections.abc import Callable
from dataclasses import dataclass

import torch

from buggy_rl.diagnosis.answer import NORMAL, Named, Value, sentence
from buggy_rl.diagnosis.candidate import Candidate
from buggy_rl.diagnosis.case import Case
from buggy_rl.diagnosis.confidence import CEILING
from buggy_rl.diagnosis.search import EAGER
from buggy_rl.estimation.cross_validation import blocks, evidence
from buggy_rl.estimation.gauss_newton import Fitted, Fitter
from buggy_rl.estimation.hypothesis import OWN

ROUNDS, ITERATIONS = 3, 4  # of the fit: between them it learns how much a nat counts
MOVED = 0.1  # of its typical size, by which a parameter must have moved to be wrong,
CERTAIN = 2.0  # and standard deviations of it: one in twenty that is right is called wrong


@dataclass(frozen=True)
class Retuned:
    """A simulator whose own parameters were fitted to the drives."""

    values: dict[str, float]
    """All of them."""
    wrong: list[Named]
    """Those that have certainly moved, the farthest first; their gain is still open."""


def retuned(case: Case, progress: Callable[[str], None] = lambda _: None) -> Retuned:
    """Fits all parameters that the simulator declares, about what they are."""
    progress(f"re-tuning {len(case.library.parameters)} parameters of the simulator's own")
    fitter = Fitter(case.player, case.cut, case.likelihood, case.library)
    own = [OWN + name for name in case.library.parameters]
    best = fitter.fit([fitter.start(own)], 0)[0]
    for _ in range(ROUNDS):
        square = best.square / case.likelihood.readings
        fitter.temper = max(1.0, EAGER * float(square.median()))
        best = fitter.fit([best], ITERATIONS)[0]
    candidate = Candidate(best, evidence(fitter, best, blocks(case.cut)))
    values = {n: v for cause, ps in best.values().items() if cause for n, v in ps.items()}
    return Retuned(values, _wrong(candidate))


def with_own(case: Case, best: Fitted) -> Fitted:
    """An explanation of the re-tuned simulator, as one of the simulator as it was given."""
    own = [OWN + name for name in case.library.parameters]
    unknowns = case.as_given.unknowns((*best.causes, *own))
    tuned = {p.name: p.value for p in case.library.parameters.values()}
    moved = [
        float(u.parameter.coordinate(tuned[u.parameter.name])) for u in unknowns if u.cause in own
    ]
    place = torch.cat([best.place[:-1], best.place.new_tensor(moved), best.place[-1:]])
    return Fitted((*best.causes, *own), unknowns, place, best.white)


def _wrong(candidate: Candidate) -> list[Named]:
    """Parameters that have certainly moved, by themselves or apart from their other side's."""
    fitted = candidate.fitted
    spread = candidate.evidence.covariance.diagonal().clamp_min(0.0).sqrt()
    apart = _apart(candidate)
    found: list[tuple[float, Named]] = []
    places = zip(fitted.unknowns, fitted.place.tolist(), spread.tolist(), strict=True)
    for index, (unknown, z, sd) in enumerate(places):
        moved = abs(z) >= max(MOVED, CERTAIN * sd)
        if not unknown.cause or not (moved or index in apart):
            continue
        p = unknown.parameter
        low, value, high = (float(p.value_at(z + k * NORMAL * sd)) for k in (-1, 0, 1))
        words = sentence(unknown.cause, {p.name: value}, p.unit, float(p.value))
        named = Named(
            name=unknown.cause,
            kind="parameter",
            equation="",
            sentence=words if moved else f"{words}: left and right certainly differ",
            parameters={p.name: Value(value, min(low, high), max(low, high), p.unit)},
            confidence=CEILING,
            held_out_gain=0.0,
        )
        found.append((abs(z), named))
    return [named for _, named in sorted(found, key=lambda item: -item[0])]


def _apart(candidate: Candidate) -> set[int]:
    """Indices of parameters of a left and a right side of which one has certainly moved.

    What turns a car as much to both sides, such as its mass, leaves each side's number open, but
    not the difference of the two.
    """
    fitted, covariance = candidate.fitted, candidate.evidence.covariance
    place = {u.parameter.name: i for i, u in enumerate(fitted.unknowns) if u.cause}
    found: set[int] = set()
    for name, left in place.items():
        right = place.get(name.replace("left", "right"), left)
        way = float(fitted.place[left] - fitted.place[right])
        variance = covariance[left, left] + covariance[right, right] - 2 * covariance[left, right]
        sd = float(variance.clamp_min(0.0).sqrt())
        if right != left and abs(way) >= max(MOVED, CERTAIN * sd):
            found |= {left, right}
    return found
