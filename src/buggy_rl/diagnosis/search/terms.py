"""Discovery of terms: equations for what a leading set leaves.

1. Every term is rolled out beside the leading set at one size, all in one batch.
2. Ranked by the loss of the straight line through its rollout, in either sense, projected off what
   the set's own numbers absorb. Terms whose lines run alike over what was driven are one.
3. The best are fitted by rollouts beside the set, held out block by block, and so is the set
   without each of its effects and terms. What has the least loss with its price goes on. Again,
   until that is what there was.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from buggy_rl.diagnosis.run.budget import FULL
from buggy_rl.diagnosis.run.case import Criteria
from buggy_rl.diagnosis.run.plan import FITTED
from buggy_rl.diagnosis.search.candidate import PRICE, Candidate
from buggy_rl.diagnosis.search.result import State, tried_too
from buggy_rl.effects.terms.grammar import PREFIX, terms
from buggy_rl.estimation.gauss_newton import Fit, Problem
from buggy_rl.estimation.hypothesis import Hypothesis
from buggy_rl.estimation.sparse import thinned

FARTHEST = 20.0  # [prior scales] at which a line ends
ALIKE = 0.98  # [-] correlation of two lines above which they are one finding
MOST = 3  # terms
ROUNDS = 5
REWEIGHTED = 4


@dataclass(frozen=True, eq=False)
class Screened:
    """A term on its line."""

    start: Hypothesis
    loss: float
    """[nats] of the line's best point, on the segments looked at."""
    move: Tensor
    """[N D] change of the weighted residuals there, less what the set's numbers absorb."""

    @property
    def name(self) -> str:
        """Name of the term."""
        return self.start.effects[-1]


@dataclass(frozen=True, eq=False)
class Discovery:
    """A leading set with its terms."""

    base: Candidate
    best: Candidate
    alike: dict[str, tuple[str, ...]]
    """Term -> terms that are the same over what was driven, the nearest first."""
    ranked: tuple[tuple[str, float], ...]
    """Terms of the first round with the gain of their lines [nats], the best first."""
    rounds: tuple[tuple[str, ...], ...]


def discovered(
    problem: Problem,
    criteria: Criteria,
    base: Candidate,
    names: Sequence[str] = (),
    looked_at: int = FULL.terms,
) -> Discovery:
    """Adds terms to a leading set, one after the other, while each is worth its price.

    Args:
        problem: With the noise model and dispersion about the set.
        criteria: Blocks and iterations.
        base: The leading set.
        names: Terms to choose from; all by default.
        looked_at: Segments, spread evenly, on which terms are screened.
    """
    names = list(names) or [t.name for t in terms()]
    dear = math.log(len(names))  # [nats] of a term more than of an effect: so many were looked at
    state = State(problem, {base.key: base, (): base})
    best, alike, first, rounds = base, {}, (), []

    def priced(candidate: Candidate) -> float:
        terms_of_it = sum(name.startswith(PREFIX) for name in candidate.effects)
        return state.loss(candidate) + PRICE * len(candidate.effects) + dear * terms_of_it

    for _ in range(ROUNDS):
        state = state.dispersed(criteria.rules.expected_left * best.typical)
        own = [name for name in best.effects if name.startswith(PREFIX)]
        starts: list[Hypothesis] = _without_one(problem, best) if own else []
        if len(own) < MOST:
            ranked = screen_terms(state.problem, best.fit, names, looked_at)
            if not first:
                none = _own_loss(state.problem, best.fit, looked_at)
                first = tuple((s.name, none - s.loss) for s in ranked[:30])
            chosen, groups = distinct(ranked, FITTED)
            alike |= groups
            starts += [s.start for s in chosen]
            rounds.append(tuple(s.name for s in chosen))
        state, found = tried_too(state, starts, criteria)
        state = state.dispersed(best.typical)
        leader = min([best, *found], key=priced)
        if leader is best:
            break
        best = leader
    kept = {name: alike[name] for name in best.effects if name in alike}
    return Discovery(base, best, kept, first, tuple(rounds))


def _without_one(problem: Problem, best: Candidate) -> list[Hypothesis]:
    """A set without each of its effects and terms, from the numbers that it has."""
    known = best.fit.named()
    return [
        problem.library.at([e for e in best.effects if e != out], known) for out in best.effects
    ]


def _own_loss(problem: Problem, fit: Fit, looked_at: int) -> float:
    few, [at] = thinned(problem, looked_at, [fit])
    return float(few.noise.loss(at.square, few.dispersion).sum())


def screen_terms(
    problem: Problem, base: Fit, names: Sequence[str], looked_at: int = FULL.terms
) -> list[Screened]:
    """Terms on their lines about a set, the most promising first."""
    few, [at] = thinned(problem, looked_at, [base])
    kept, clock = base.vector[:-1], base.vector[-1:]
    one = torch.ones(1, dtype=base.vector.dtype)
    starts = [
        replace(
            problem.library.hypothesis((*base.effects, name)),
            vector=torch.cat([kept, one, clock]),
        )
        for name in names
        if name not in base.effects
    ]
    rolled = few.rolled_out(starts)
    return sorted((_on_line(few, at, trial) for trial in rolled), key=lambda s: s.loss)


def _on_line(problem: Problem, base: Fit, trial: Fit) -> Screened:
    """r(a, b) = r_base + a move + J b, with the best a and b by reweighted least squares."""
    noise, phi = problem.noise, problem.dispersion
    assert base.jacobian is not None
    columns = torch.cat([(trial.whitened - base.whitened).unsqueeze(-1), base.jacobian], -1)
    precision = torch.cat([torch.zeros(1, dtype=columns.dtype), base.prior**-2])
    precision[0] = 9.0**-1
    centre = torch.cat([torch.zeros(1, dtype=columns.dtype), -base.vector])
    square, step, weight = base.square, torch.zeros_like(centre), base.square
    for _ in range(REWEIGHTED):
        weight = noise.weight(square, phi) / phi
        hessian = torch.einsum("ndp,ndq,n->pq", columns, columns, weight)
        hessian = hessian + torch.diag(precision)
        score = torch.einsum("ndp,nd,n->p", columns, base.whitened, weight) - precision * centre
        step = -torch.linalg.solve(hessian, score)
        step[0] = step[0].clamp(-FARTHEST, FARTHEST)
        square = (base.whitened + columns @ step).square().sum(-1)
    loss = float(noise.loss(square, phi).sum())
    loss += 0.5 * float((precision * (step - centre).square()).sum())
    root = weight.sqrt().unsqueeze(-1)
    move, own = (
        (root * columns[..., 0]).flatten(),
        (root.unsqueeze(-1) * base.jacobian).flatten(0, 1),
    )
    move = move - own @ torch.linalg.lstsq(own, move.unsqueeze(-1)).solution.squeeze(-1)
    vector = torch.cat([base.vector[:-1] + step[1:-1], step[:1], base.vector[-1:] + step[-1:]])
    return Screened(
        Hypothesis(trial.effects, trial.coordinates, vector), loss, float(step[0].sign()) * move
    )


def distinct(
    ranked: Sequence[Screened], most: int
) -> tuple[list[Screened], dict[str, tuple[str, ...]]]:
    """The best terms, none of whose lines runs like a better one's; and those that do."""
    chosen: list[Screened] = []
    units: list[Tensor] = []
    groups: dict[str, list[str]] = {}
    for each in ranked:
        norm = float(each.move.norm())
        if norm < 1e-9:
            continue
        unit = each.move / norm
        near = [float(unit @ u) for u in units]
        if near and max(near) > ALIKE:
            groups[chosen[near.index(max(near))].name].append(each.name)
        elif len(chosen) < most:
            chosen.append(each)
            units.append(unit)
            groups[each.name] = []
    return chosen, {name: tuple(own) for name, own in groups.items()}
