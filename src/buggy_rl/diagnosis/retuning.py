"""The other null: the simulator with all its own parameters fitted, before physics is missed."""

from collections.abc import Callable
from dataclasses import dataclass

import torch

from buggy_rl.diagnosis.answer import NORMAL, Named, Value, sentence
from buggy_rl.diagnosis.candidate import Candidate
from buggy_rl.diagnosis.case import Case
from buggy_rl.diagnosis.confidence import CEILING
from buggy_rl.diagnosis.evidence import blocks, evidence
from buggy_rl.diagnosis.fit import Fitter
from buggy_rl.diagnosis.library import OWN
from buggy_rl.diagnosis.search import EAGER

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
    return Retuned(values, wrong(candidate))


def wrong(candidate: Candidate) -> list[Named]:
    """Parameters that have certainly moved, the farthest first."""
    fitted = candidate.fitted
    spread = candidate.evidence.covariance.diagonal().clamp_min(0.0).sqrt()
    found: list[tuple[float, Named]] = []
    for unknown, z, sd in zip(fitted.unknowns, fitted.place.tolist(), spread.tolist(), strict=True):
        if not unknown.cause or abs(z) < max(MOVED, CERTAIN * sd):
            continue
        p = unknown.parameter
        low, value, high = (float(p.value_at(z + k * NORMAL * sd)) for k in (-1, 0, 1))
        named = Named(
            name=unknown.cause,
            kind="parameter",
            equation="",
            sentence=sentence(unknown.cause, {p.name: value}, p.unit, float(p.value)),
            parameters={p.name: Value(value, min(low, high), max(low, high), p.unit)},
            confidence=CEILING,
            held_out_gain=0.0,
        )
        found.append((abs(z), named))
    said = {named.name for _, named in found}
    found += [later for later in _delays(candidate) if said.isdisjoint(_parts(later[1]))]
    return [named for _, named in sorted(found, key=lambda item: -item[0])]


def _parts(named: Named) -> set[str]:
    return {OWN + parameter for parameter in named.parameters}


def _delays(candidate: Candidate) -> list[tuple[float, Named]]:
    """Channels that are certainly later, or sooner, than simulated, and by how many sizes.

    Of a dead time and a lag drives often tell no more than the sum: each alone is not certain.
    """
    fitted, covariance = candidate.fitted, candidate.evidence.covariance
    index = {u.cause: i for i, u in enumerate(fitted.unknowns)}
    found = []
    for channel in ("steering", "throttle"):
        causes = [f"{OWN}{channel}_{part}" for part in ("dead_time", "lag")]
        if not set(causes) <= set(index):
            continue
        rows = [index[cause] for cause in causes]
        parts = [fitted.unknowns[row].parameter for row in rows]
        sizes = torch.tensor([p.size for p in parts], dtype=torch.float64)
        later = float(sizes @ fitted.place[rows])  # [s]
        sd = float(sizes @ covariance[rows][:, rows] @ sizes) ** 0.5
        size = max(p.size for p in parts)
        if abs(later) < max(MOVED * size, CERTAIN * sd):
            continue
        values = {}
        for row, p in zip(rows, parts, strict=True):
            z, own = float(fitted.place[row]), float(covariance[row, row].clamp_min(0.0)) ** 0.5
            low, value, high = (float(p.value_at(z + k * NORMAL * own)) for k in (-1, 0, 1))
            values[p.name] = Value(value, max(low, p.lower), min(high, p.upper), p.unit)
        named = Named(
            name=causes[0],
            kind="parameter",
            equation="",
            sentence=(
                f"the {channel} is {1000 * abs(later):.0f} ms {'later' if later > 0 else 'sooner'} "
                f"than simulated, dead time and lag together"
            ),
            parameters=values,
            confidence=CEILING,
            held_out_gain=0.0,
        )
        found.append((abs(later) / size, named))
    return found
