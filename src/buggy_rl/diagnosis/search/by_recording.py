"""Effects whose numbers are others in each recording: a car that differs from drive to drive.

A servo horn slips, a battery is another one, a floor has been swept. What recordings do not share
no effect with one number closes. It enters the noise model as a random effect, so that what is
named is what all recordings share.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from buggy_rl.diagnosis.run.case import Criteria
from buggy_rl.diagnosis.search.candidate import PRICE, Candidate, held_out_square
from buggy_rl.diagnosis.search.ways import unit_changes
from buggy_rl.estimation.evidence import NOTHING, misfit
from buggy_rl.estimation.gauss_newton import Fit, Problem
from buggy_rl.estimation.hypothesis import Library
from buggy_rl.estimation.sparse import trials

SIZE = (0.4,)  # [prior scales] of the trials whose secants stand for derivatives
DIRECTIONS = 2  # of an effect at most: more are places on the floor, which recordings share
CLOSES = 0.5  # [-] of what is left that all of them close at least,
EACH = 0.25  # [-] and each; chosen, and held to by benchmarks/by_recording.py
MOST = 3  # effects
LEAST = 0.01  # [prior scales] deviation from which a rollout tells its secant


@dataclass(frozen=True)
class Difference:
    """An effect that is another one in each recording."""

    effect: str
    numbers: Mapping[str, Mapping[str, float]]
    """Recording -> number -> value in its unit."""
    units: Mapping[str, str]
    """Number -> unit."""
    closes: float
    """Share of what is left that all that differ close, on what was held out."""
    nats: float
    """Nats that they gain there."""

    def words(self) -> str:
        """The effect, and its numbers in each recording."""
        each = ", ".join(f"{_in_words(v, self.units)} in {k}" for k, v in self.numbers.items())
        return f"{self.effect} ({each})"

    def to_dict(self) -> dict[str, Any]:
        """Makes its entry in `diagnosis.json`."""
        return dict(vars(self))


@dataclass(frozen=True, eq=False)
class ByRecording:
    """What recordings do not share."""

    differences: tuple[Difference, ...] = ()
    covariance: Tensor | None = None
    """[N, D, D] of residuals of each segment."""


@dataclass(frozen=True, eq=False)
class _Way:
    """An effect about a base, by recording."""

    effect: str
    directions: tuple[tuple[float, ...], ...]
    """Q ways that its numbers go, each [numbers of the effect]."""
    columns: Tensor
    """[N, D, Q] change of whitened residuals by one prior scale along each."""

    def apart(self, recording: Tensor) -> Tensor:
        """[N, D, Q R], for each of R recordings apart."""
        own = torch.nn.functional.one_hot(recording).to(self.columns)
        return (self.columns.unsqueeze(-1) * own[:, None, None, :]).flatten(2)


def by_recording(
    criteria: Criteria, problem: Problem, null: Candidate, best: Candidate, names: Sequence[str]
) -> ByRecording:
    """Effects that differ between recordings and close most of what is left.

    About nothing and about the best set: r + J d + sum_q m_q b_qk of a segment in recording k, with
    blocks held out one at a time.

    Args:
        criteria: Blocks and priors.
        problem: With the noise model that a search came to.
        null: The simulator as given.
        best: The set that predicts best.
        names: Of the recordings.
    """
    known, recording = problem.segments.recording.unique(return_inverse=True)
    if len(known) < 2:
        return ByRecording()
    looked = _Look(criteria, problem, null, recording)
    bases = {c.key: c for c in (null, best)}
    plain = {key: looked.priced(base) for key, base in bases.items()}
    least = min(plain.values(), key=lambda p: p.loss)
    if least.left <= NOTHING:
        return ByRecording()
    found = [looked.about(base, plain[key], least) for key, base in bases.items()]
    if not (closing := [f for f in found if f.priced.left <= (1 - CLOSES) * least.left]):
        return ByRecording()
    chosen = min(closing, key=lambda f: f.priced.loss)
    fit, nats = chosen.base.fit, least.loss - chosen.priced.loss
    first = _estimated(problem, fit, chosen.ways, recording)
    ways = _at_size(problem, fit, chosen.ways, first, recording)
    deviations = _estimated(problem, fit, ways, recording)
    library, closes = problem.library, 1 - chosen.priced.left / least.left
    differences = tuple(
        Difference(
            way.effect,
            {
                names[int(number)]: _values(library, fit, way, own[:, k].tolist())
                for k, number in enumerate(known)
            },
            {p.name: p.unit for p in library.numbers(way.effect)},
            closes,
            nats,
        )
        for way, own in zip(ways, deviations, strict=True)
    )
    return ByRecording(differences, _covariance(problem, ways, deviations, recording))


@dataclass(frozen=True)
class _Priced:
    """What a base and effects by recording leave on what was held out."""

    loss: float
    """[nats] with `PRICE` for each effect and number."""
    left: float
    """Excess misfit beyond the baseline's."""


@dataclass(frozen=True, eq=False)
class _About:
    """Effects by recording about a base."""

    base: Candidate
    ways: list[_Way]
    priced: _Priced


@dataclass(frozen=True, eq=False)
class _Look:
    """What is looked at."""

    criteria: Criteria
    problem: Problem
    null: Candidate
    recording: Tensor
    """[N] int, 0 to R - 1."""

    def about(self, base: Candidate, plain: _Priced, least: _Priced) -> _About:
        """Effects about a base: one more while it closes its share of what was left.

        Each is compared with the same effect shared by all recordings.
        """
        found, others = _About(base, [], plain), _ways(self.problem, base.fit)
        while others and len(found.ways) < MOST:
            tried = [self.priced(base, [*found.ways, way], apart=True) for way in others]
            first = min(range(len(tried)), key=lambda i: tried[i].loss)
            ways = [*found.ways, others.pop(first)]
            shared = [found.priced, self.priced(base, ways)]
            than, now = min(shared, key=lambda p: p.loss), tried[first]
            if now.loss > than.loss or than.left - now.left < EACH * least.left:
                break
            found = _About(base, ways, now)
        return found

    def priced(self, base: Candidate, ways: Sequence[_Way] = (), apart: bool = False) -> _Priced:
        """A base with effects, by recording or shared by all."""
        problem, none = self.problem, base.fit.whitened.new_zeros(*base.fit.whitened.shape, 0)
        parts = [w.apart(self.recording) if apart else w.columns for w in ways]
        more = torch.cat([none, *parts], -1)
        square = held_out_square(self.criteria, problem, base, more)
        loss = float(problem.noise.loss(square, problem.dispersion).sum() + base.fit.penalty())
        excess = misfit(square / problem.noise.dimension, self.null.held_out) - 1
        chosen = math.log(len(problem.library.names)) * len(ways)  # [nats] each one of so many
        price = PRICE * (len(base.effects) + more.shape[-1]) + chosen
        return _Priced(loss + price, self.criteria.usual.beyond(excess))


def _ways(problem: Problem, base: Fit) -> list[_Way]:
    """Effects with few directions: those that a base lacks by trials, its own by derivatives."""
    assert base.jacobian is not None
    ways, changes = unit_changes(base, problem.rolled_out(trials(problem, base, SIZE)))
    found: dict[str, dict[tuple[float, ...], Tensor]] = {}
    for (name, direction), column in zip(ways, changes.unbind(-1), strict=True):
        found.setdefault(name, {})[direction] = column
    for name in base.effects:
        own = [i for i, c in enumerate(base.coordinates) if c.effect == name]
        eye = torch.eye(len(own)).tolist()
        found[name] = {tuple(eye[n]): base.jacobian[..., i] for n, i in enumerate(own)}
    return [
        _Way(name, tuple(columns), torch.stack([*columns.values()], -1))
        for name, columns in found.items()
        if len(columns) <= DIRECTIONS
    ]


def _estimated(
    problem: Problem, base: Fit, ways: Sequence[_Way], recording: Tensor
) -> list[Tensor]:
    """Deviations [Q, R] of each effect from the base, prior scales along its directions."""
    assert base.jacobian is not None
    parts = [way.apart(recording) for way in ways]
    columns = torch.cat([base.jacobian, *parts], -1)
    weight = problem.noise.weight(base.square, problem.dispersion) / problem.dispersion
    prior = torch.cat([base.prior, torch.ones(columns.shape[-1] - len(base.prior)).double()])
    vector = torch.zeros_like(prior)
    vector[: len(base.vector)] = base.vector
    hessian = torch.einsum("ndp,ndq,n->pq", columns, columns, weight) + torch.diag(prior**-2)
    gradient = torch.einsum("ndp,nd,n->p", columns, base.whitened, weight) + vector / prior**2
    solution = -torch.linalg.solve(hessian, gradient)[len(base.vector) :]
    sizes = [part.shape[-1] for part in parts]
    return [
        own.view(len(way.directions), -1)
        for way, own in zip(ways, solution.split(sizes), strict=True)
    ]


def _at_size(
    problem: Problem,
    base: Fit,
    ways: Sequence[_Way],
    deviations: Sequence[Tensor],
    recording: Tensor,
) -> list[_Way]:
    """Effects with secants from rollouts at their own deviation in each recording."""
    rows = []
    for way, own in zip(ways, deviations, strict=True):
        names = base.effects if way.effect in base.effects else (*base.effects, way.effect)
        about = problem.library.at(names, base.named())
        place = [i for i, c in enumerate(about.coordinates) if c.effect == way.effect]
        for direction, by_recording in zip(way.directions, own, strict=True):
            moved = about.vector.repeat(len(recording), 1)
            step = torch.tensor(direction, dtype=moved.dtype)
            moved[:, place] += by_recording[recording].unsqueeze(1) * step
            rows.append((about, about.bounded(moved)))
    rolled = iter(problem.whitened(rows))
    result = []
    for way, own in zip(ways, deviations, strict=True):
        columns = [
            torch.where(size.abs() > LEAST, (next(rolled) - base.whitened) / size, column)
            for size, column in zip(
                own[:, recording].unsqueeze(-1), way.columns.unbind(-1), strict=True
            )
        ]
        result.append(replace(way, columns=torch.stack(columns, -1)))
    return result


def _values(library: Library, base: Fit, way: _Way, deviation: Sequence[float]) -> dict[str, float]:
    """Numbers of an effect at the base's and a deviation along each of its directions."""
    known, result = base.named(), {}
    for n, p in enumerate(library.numbers(way.effect)):
        moved = sum(d[n] * z for d, z in zip(way.directions, deviation, strict=True))
        value = float(p.value_at(known.get((way.effect, p.name), 0.0) + moved))
        result[p.name] = min(max(value, p.lower), p.upper)
    return result


def _covariance(
    problem: Problem, ways: Sequence[_Way], deviations: Sequence[Tensor], recording: Tensor
) -> Tensor:
    """[N, D, D] N_k sum_q sd_q^2 s_q s_q^T of a segment of recording k, which has N_k of them.

    Segments of a recording share its deviation: N_k of them tell as little of their mean as one.
    """
    count = torch.bincount(recording)[recording].double()
    parts = [
        way.columns * own.std(1) * count[:, None, None].sqrt()
        for way, own in zip(ways, deviations, strict=True)
    ]
    changes = torch.linalg.solve_triangular(
        problem.noise.whitening, torch.cat(parts, -1), upper=False
    )
    return changes @ changes.mT


def _in_words(values: Mapping[str, float], units: Mapping[str, str]) -> str:
    return " and ".join(
        f"{name.replace('_', ' ')} {value:.3g}{f' {units[name]}' * (units[name] not in ('', '-'))}"
        for name, value in values.items()
    )
