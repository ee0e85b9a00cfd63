"""Discovery of terms: equations for what a leading set leaves.

1. Every term is rolled out beside the leading set at one size, all in one batch, on a quarter of
   the segments; the best quarter of the terms on all of them, at first and after every term taken.
2. Ranked by the loss of the straight line through its rollout, in either sense, projected off what
   the set's own numbers absorb. Terms whose lines run alike over what was driven are one.
3. The best, of those whose lines promise half their price, are fitted by rollouts beside the set,
   held out block by block, and so is the set without each of its effects and terms. What has the
   least loss with its price goes on. Again, until that is what there was.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from buggy_rl.diagnosis.run.budget import FULL
from buggy_rl.diagnosis.run.case import Criteria
from buggy_rl.diagnosis.run.plan import FITTED, GLANCE
from buggy_rl.diagnosis.search.candidate import PRICE, Candidate
from buggy_rl.diagnosis.search.result import State, tried_too
from buggy_rl.effects.terms.grammar import PREFIX, terms
from buggy_rl.estimation.gauss_newton import Fit, Problem
from buggy_rl.estimation.hypothesis import OWN, Hypothesis
from buggy_rl.estimation.sparse import thinned

FARTHEST = 20.0  # [prior scales] at which a line ends
ALIKE = 0.98  # [-] correlation of two lines above which they are one finding
MOST = 3  # terms
ROUNDS = 5
REWEIGHTED = 4
LEAST = 40  # terms that are looked at on all segments, of how few ever
HOPED = 0.5  # [-] of its price that a line promises at least for its term to be fitted; chosen
TOGETHER = 200  # trials whose lines are solved at once, to bound memory


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

    begun = state.dispersed(criteria.rules.expected_left * best.typical).problem
    glanced = screen_terms(begun, base.fit, names, math.ceil(looked_at / GLANCE))
    promising = [s.name for s in glanced[: max(LEAST, math.ceil(len(glanced) / GLANCE))]]
    for _ in range(ROUNDS):
        state = state.dispersed(criteria.rules.expected_left * best.typical)
        own = [name for name in best.effects if name.startswith(PREFIX)]
        starts = _without_one(problem, best) if own else []
        if len(own) < MOST and (not rounds or rounds[-1]):
            ranked = screen_terms(state.problem, best.fit, promising, looked_at)
            none, share = _own_loss(state.problem, best.fit, looked_at)
            if not first:
                first = tuple((s.name, none - s.loss) for s in ranked[:30])
            least = HOPED * (PRICE + dear) * share
            most = FITTED // 2 if own else FITTED  # the first one explains the most
            chosen, groups = distinct([s for s in ranked if none - s.loss > least], most)
            alike |= groups
            starts += _begun(state.problem, best.fit, [s.start for s in chosen])
            rounds.append(tuple(s.name for s in chosen))
        if not starts:
            break
        state, found = _fitted_beside(state, best.fit, starts, criteria)
        state = state.dispersed(best.typical)
        leader = min([best, *found], key=priced)
        if leader is best:
            break
        best = leader
    if best is not base and any(name.startswith(OWN) for name in best.effects):
        _, [best] = tried_too(state, [best.fit], criteria)  # by derivatives of its own
    kept = {name: alike[name] for name in best.effects if name in alike}
    return Discovery(base, best, kept, first, tuple(rounds))


def _begun(problem: Problem, base: Fit, ends: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Hypotheses from which sets with a term are fitted: ends of lines, or the set without one.

    Of dozens of parameters a line leads far, to where it holds no longer.
    """
    known, without = base.named(), problem.cost(base)
    return [
        end if problem.cost(there) < without else problem.library.at(end.effects, known)
        for end, there in zip(ends, problem.rolled_out(ends), strict=True)
    ]


def _fitted_beside(
    state: State, base: Fit, starts: Sequence[Hypothesis], criteria: Criteria
) -> tuple[State, list[Candidate]]:
    """Sets about a leading one, fitted; derivatives by the simulator's parameters are the base's.

    Those are dozens of columns that a term hardly changes: to find them anew for each of the sets
    takes ten times as long as all that the sets differ by.
    """
    assert base.jacobian is not None
    known = {
        (c.effect, c.parameter.name): base.jacobian[..., i]
        for i, c in enumerate(base.coordinates)
        if c.effect.startswith(OWN)
    }
    beside = replace(state, problem=replace(state.problem, known=known))
    beside, found = tried_too(beside, starts, criteria)
    return replace(beside, problem=state.problem), found


def _without_one(problem: Problem, best: Candidate) -> list[Hypothesis]:
    """A set without each of its effects and terms, from the numbers that it has.

    Parameters of the simulator stay: they are a layer as a whole, which a term cannot stand for.
    """
    known = best.fit.named()
    return [
        problem.library.at([e for e in best.effects if e != out], known)
        for out in best.effects
        if not out.startswith(OWN)
    ]


def _own_loss(problem: Problem, fit: Fit, looked_at: int) -> tuple[float, float]:
    """Loss of a fit on the segments looked at, as that of a line is, and their share of all."""
    few, [at] = thinned(problem, looked_at, [fit])
    prior = 0.5 * (fit.vector / at.prior).square().sum()
    loss = few.noise.loss(at.square, few.dispersion).sum() + prior
    return float(loss), len(few.segments) / len(problem.segments)


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
    parts = (rolled[i : i + TOGETHER] for i in range(0, len(rolled), TOGETHER))
    found = (screened for part in parts for screened in _on_lines(few, at, part))
    return sorted(found, key=lambda s: s.loss)


def _on_lines(problem: Problem, base: Fit, trials: Sequence[Fit]) -> list[Screened]:
    """r(a, b) = r_base + a move + J b, with the best a and b by reweighted least squares.

    T trials at once, by the products of their moves with the residuals and J of each segment.
    """
    noise, phi, own = problem.noise, problem.dispersion, base.jacobian
    assert own is not None
    moves = torch.stack([trial.whitened for trial in trials]) - base.whitened  # (T, N, D)
    beside = torch.einsum("tnd,ndp->tnp", moves, own)
    square_own = (own.mT @ own).flatten(1)  # (N, P P)
    along = (moves * base.whitened).sum(-1)  # (T, N)
    along_own = (base.whitened.unsqueeze(-2) @ own).squeeze(-2)  # (N, P)
    square_move = moves.square().sum(-1)  # (T, N)
    precision = torch.cat([moves.new_tensor([9.0**-1]), base.prior**-2])
    centre = torch.cat([moves.new_zeros(1), -base.vector])
    square = base.square.expand(len(trials), -1)
    hessian = moves.new_empty(len(trials), len(centre), len(centre))
    step, weight = moves.new_zeros(len(trials), len(centre)), square
    for _ in range(REWEIGHTED):
        weight = noise.weight(square, phi) / phi  # (T, N)
        hessian[:, 0, 0] = (weight * square_move).sum(-1)
        hessian[:, 0, 1:] = hessian[:, 1:, 0] = (weight.unsqueeze(1) @ beside).squeeze(1)
        hessian[:, 1:, 1:] = (weight @ square_own).unflatten(1, own.shape[-1:] * 2)
        score = torch.cat([(weight * along).sum(-1, keepdim=True), weight @ along_own], 1)
        score = score - precision * centre
        step = -torch.linalg.solve(hessian + torch.diag(precision), score)
        step[:, 0] = step[:, 0].clamp(-FARTHEST, FARTHEST)
        a, rest = step[:, :1], step[:, 1:]
        square = base.square + a.square() * square_move + 2 * a * along
        square = square + 2 * (rest @ along_own.T + a * (beside @ rest.unsqueeze(-1)).squeeze(-1))
        square = square + (rest.unsqueeze(-1) * rest.unsqueeze(1)).flatten(1) @ square_own.T
        square = square.clamp_min(0.0)
    loss = noise.loss(square, phi).sum(-1)
    loss = loss + 0.5 * (precision * (step - centre).square()).sum(-1)
    absorbed = torch.linalg.pinv(hessian[:, 1:, 1:], hermitian=True) @ hessian[:, 1:, :1]
    left = moves - (own @ absorbed.unsqueeze(1)).squeeze(-1)  # (T, N, D)
    left = (step[:, :1].sign() * weight.sqrt()).unsqueeze(-1) * left
    vectors = torch.cat([base.vector[:-1] + step[:, 1:-1], step[:, :1]], 1)
    vectors = torch.cat([vectors, base.vector[-1:] + step[:, -1:]], 1)
    return [
        Screened(Hypothesis(trial.effects, trial.coordinates, vector), float(lost), move.flatten())
        for trial, vector, lost, move in zip(trials, vectors, loss, left, strict=True)
    ]


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
