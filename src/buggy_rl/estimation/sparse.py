"""Screening by trial sizes, and sets of effects proposed together by linear algebra.

Each trial is a rollout of the base with one effect more, each removal one with an effect less; the
secant of either is the change of the whitened residuals. To first order the changes add up, so one
batch of rollouts tells of every set what would remain. What is found is a place to start a fit, not
an answer.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import torch
from torch import Tensor

from buggy_rl.estimation.gauss_newton import Fit, Problem
from buggy_rl.estimation.hypothesis import TRIAL_SIZES, Hypothesis

FARTHEST = 1.5  # [-] times its trial size that an effect may have
REWEIGHTED = 4  # times that heavy-tailed weights are computed anew
ROUGHLY = 2  # times, of many sets, to choose those that are solved in full
CHOSEN = 10  # of those, times as many as are wanted
BEAM = 200  # sets of one size that are extended; numerical
CHUNK = 4_000  # sets that are solved at once, to bound memory
FIXED = 1e12  # [-] precision of a coefficient that is held at its bound


@dataclass(frozen=True)
class Proposal:
    """A set of effects, and where its fit should begin."""

    start: Hypothesis
    loss: float
    """Loss of the superposition, with its prior penalty [nats]."""

    @property
    def key(self) -> tuple[str, ...]:
        """Effects of the proposal, sorted."""
        return tuple(sorted(self.start.effects))


@dataclass(frozen=True, eq=False)
class _Products:
    """Products of the columns of C sets of k trials and P coordinates that all of them have.

    The coordinates come last in what is solved for, R = k + P. Products of them alone are kept
    once, those with a trial for each set.
    """

    left: Tensor
    """[N] square of what is to be explained, r."""
    along: Tensor
    """[C, k, N] products of r with the trials."""
    along_own: Tensor
    """[P, N] products of r with the coordinates."""
    pairs: Tensor
    """[C, k (k + 1) / 2 + k P, N] products among trials, and of trials with coordinates."""
    own: Tensor
    """[N, P * P] products of coordinates."""

    def hessian(self, weight: Tensor) -> Tensor:
        """[C, R, R] of segments with weights [C, N]."""
        count, k = self.along.shape[:2]
        p = len(self.along_own)
        found = (self.pairs @ weight.unsqueeze(-1)).squeeze(-1)
        among, beside = found.split([k * (k + 1) // 2, k * p], 1)
        rows, cols = torch.triu_indices(k, k)
        full = weight.new_empty(count, k + p, k + p)
        full[:, rows, cols] = among
        full[:, cols, rows] = among
        full[:, :k, k:] = beside.view(count, k, p)
        full[:, k:, :k] = full[:, :k, k:].mT
        full[:, k:, k:] = (weight @ self.own).view(count, p, p)
        return full

    def score(self, weight: Tensor) -> Tensor:
        """[C, R] of segments with weights [C, N]."""
        trials = (self.along @ weight.unsqueeze(-1)).squeeze(-1)
        return torch.cat([trials, weight @ self.along_own.T], 1)

    def square(self, solution: Tensor) -> Tensor:
        """What is left [C, N] of the square at coefficients [C, R]."""
        k = self.along.shape[1]
        trials, own = solution[:, :k], solution[:, k:]
        rows, cols = torch.triu_indices(k, k)
        among = trials[:, rows] * trials[:, cols] * torch.where(rows == cols, 1.0, 2.0)
        beside = 2 * (trials.unsqueeze(-1) * own.unsqueeze(1)).flatten(1)
        twice = 2 * (own @ self.along_own + (trials.unsqueeze(1) @ self.along).squeeze(1))
        pairs = torch.cat([among, beside], 1).unsqueeze(1) @ self.pairs
        alone = (own.unsqueeze(-1) * own.unsqueeze(1)).flatten(1) @ self.own.T
        return (self.left + twice + pairs.squeeze(1) + alone).clamp_min(0.0)


@dataclass(frozen=True, eq=False)
class Secants:
    """Superposition of the secants of trials, and of removals, about a base."""

    problem: Problem
    base: Fit
    trials: Sequence[Fit]
    """Rollouts of the base with one more effect each, the last of its effects."""
    removals: Sequence[Fit]
    """Rollouts of the base without one of its effects, one for each of them, in their order."""
    gram: Tensor
    """[N, M, M] products of (residual, P derivatives, R removals, T trials) of each segment."""

    @classmethod
    def of(
        cls, problem: Problem, base: Fit, trials: Sequence[Fit], removals: Sequence[Fit] = ()
    ) -> "Secants":
        """Makes secants from rollouts of trials and removals; the base has its derivatives."""
        assert base.jacobian is not None
        moves = [fit.whitened - base.whitened for fit in (*removals, *trials)]
        columns = [base.whitened.unsqueeze(-1), base.jacobian, torch.stack(moves, -1)]
        wide = torch.cat(columns, -1)  # (N, D, M)
        return cls(problem, base, trials, removals, wide.mT @ wide)

    def solved(
        self, members: Tensor, removed: Sequence[int] = (), times: int = REWEIGHTED
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Least loss of each set of trials, and its coefficients.

        r = r_base + sum d_removed + sum a_t m_t + J b,  0 <= a <= `FARTHEST`, by reweighted least
        squares.

        Args:
            members: [C, k] indices of trials.
            removed: Effects of the base, by index, that are taken out.
            times: That the weights are computed.

        Returns:
            Losses [C], a [C, k] and b [C, P] of the coordinates of `kept(removed)`.
        """
        parts = [self._solved(part, removed, times) for part in members.split(CHUNK)]
        return tuple(torch.cat(p) for p in zip(*parts, strict=True))  # type: ignore[return-value]

    def kept(self, removed: Sequence[int]) -> list[int]:
        """Coordinates of the base that are left without some of its effects, by index."""
        out = {self.base.effects[i] for i in removed}
        return [i for i, c in enumerate(self.base.coordinates) if c.effect not in out]

    def _solved(
        self, members: Tensor, removed: Sequence[int], times: int
    ) -> tuple[Tensor, Tensor, Tensor]:
        noise, phi = self.problem.noise, self.problem.dispersion
        products = self._products(members, removed)
        precision, centre = self._prior(members, removed)
        k = members.shape[1]
        low = torch.full_like(centre, -torch.inf)
        high = torch.full_like(centre, torch.inf)
        low[:, :k], high[:, :k] = 0.0, FARTHEST
        square = products.left.expand(len(members), -1)
        solution = torch.zeros_like(centre)
        for _ in range(times):
            weight = noise.weight(square, phi) / phi  # (C, N)
            hessian = products.hessian(weight) + torch.diag_embed(precision)
            score = products.score(weight) - precision * centre
            now, at = torch.zeros_like(centre, dtype=torch.bool), torch.zeros_like(centre)
            for _ in range(2):
                stiff = torch.where(now, FIXED, 0.0)
                full = hessian + torch.diag_embed(stiff)
                solution = torch.linalg.solve(full, stiff * at - score)
                out = (solution < low) | (solution > high)
                now = now | out
                at = torch.where(out, solution.clamp(low, high), at)
            solution = solution.clamp(low, high)
            square = products.square(solution)
        loss = noise.loss(square, phi).sum(-1)
        loss = loss + 0.5 * (precision * (solution - centre).square()).sum(-1)
        return loss, solution[:, :k], solution[:, k:]

    def _products(self, members: Tensor, removed: Sequence[int]) -> "_Products":
        size, kept = len(self.base.coordinates), self.kept(removed)
        own = torch.tensor([1 + i for i in kept], dtype=torch.long)
        origin = [0, *(1 + size + i for i in removed)]
        count = len(self.gram)
        columns = 1 + size + len(self.removals) + members  # (C, k)
        rows, cols = torch.triu_indices(members.shape[1], members.shape[1])
        among = columns[:, rows] * self.gram.shape[-1] + columns[:, cols]
        beside = (columns * self.gram.shape[-1]).unsqueeze(-1) + own  # (C, k, P)
        wanted = torch.cat([among, beside.flatten(1)], 1)
        by_pair = self._by_pair
        along = self.gram[:, origin].sum(1).T.contiguous()  # (M, N)
        return _Products(
            left=self.gram[:, origin][:, :, origin].sum((1, 2)),
            along=along[columns],
            along_own=along[own],
            pairs=by_pair.index_select(0, wanted.reshape(-1)).view(*wanted.shape, count),
            own=self.gram[:, own][:, :, own].flatten(1),
        )

    @cached_property
    def _by_pair(self) -> Tensor:
        """`gram` [M * M, N]."""
        return self.gram.flatten(1).T.contiguous()

    def _prior(self, members: Tensor, removed: Sequence[int]) -> tuple[Tensor, Tensor]:
        """Precision and centre [C, k + P] of the coefficients."""
        sizes, kept = self._sizes, self.kept(removed)
        base = self.base.prior[kept] ** -2
        precision = torch.cat([sizes[members], base.expand(len(members), -1)], 1).clamp_min(1e-9)
        centre = torch.zeros_like(precision)
        centre[:, members.shape[1] :] = -self.base.vector[kept]
        return precision, centre

    @cached_property
    def _sizes(self) -> Tensor:
        """Squared sizes of the trials [T], in prior scales."""
        sizes = torch.zeros(len(self.trials), dtype=self.base.vector.dtype)
        for number, trial in enumerate(self.trials):
            own = [i for i, c in enumerate(trial.coordinates) if c.effect == trial.effects[-1]]
            sizes[number] = (trial.vector[own] / trial.prior[own]).square().sum()
        return sizes


def proposals(
    secants: Secants,
    most: int,
    added: int = 3,
    removed: int = 0,
    also: Sequence[Sequence[str]] = (),
) -> list[Proposal]:
    """The best sets of effects about a base, the most promising first.

    Args:
        secants: Of trials, and of removals, about the base.
        most: Effects of a set at most.
        added: Effects that are added to the base at most.
        removed: Effects of the base that are taken out at most.
        also: Sets added to the whole base that are proposed too, promising or not.
    """
    names = [trial.effects[-1] for trial in secants.trials]
    number = {name: i for i, name in enumerate(dict.fromkeys(names))}
    effect = torch.tensor([number[name] for name in names])
    best: dict[frozenset[str], Proposal] = {}
    for out in _choices(len(secants.removals), removed):
        left = len(secants.base.effects) - len(out)
        members = torch.zeros(1, 0, dtype=torch.long)
        for size in range(min(added, most - left) + 1):
            if size or out:  # the base itself is no proposal
                members = _best(secants, members, out, best, BEAM if not out else BEAM // 4)
            members = _grown(members, effect)
    every = torch.arange(len(names))
    for names_of in also:
        own = [every[effect == number[name]] for name in names_of]
        if own:
            _best(secants, torch.cartesian_prod(*own).reshape(-1, len(own)), (), best, 1)
    return sorted(best.values(), key=lambda proposal: proposal.loss)


def _choices(count: int, most: int) -> Iterator[tuple[int, ...]]:
    """Sets of at most `most` of the base's effects, the empty one first."""
    for size in range(most + 1):
        yield from combinations(range(count), size)


def _grown(members: Tensor, effect: Tensor) -> Tensor:
    """Sets [C, k] with one trial more of another effect, [C', k + 1]."""
    every = torch.arange(len(effect))
    more = every.repeat(len(members)).unsqueeze(1)
    grown = torch.cat([members.repeat_interleave(len(every), 0), more], 1)
    return grown[~(effect[grown[:, :-1]] == effect[grown[:, -1:]]).any(1)]


def _best(
    secants: Secants,
    members: Tensor,
    removed: Sequence[int],
    best: dict[frozenset[str], Proposal],
    most: int,
) -> Tensor:
    """The best sets [C', k], each of its own effects; enters those that are new or better."""
    if len(members) > CHOSEN * most:
        rough, _, _ = secants.solved(members, removed, ROUGHLY)
        members = members[rough.argsort()[: CHOSEN * most]]
    loss, share, moved = secants.solved(members, removed)
    kept = {e for i, e in enumerate(secants.base.effects) if i not in removed}
    chosen: list[int] = []
    seen = set()
    for row in loss.argsort().tolist():
        key = frozenset(kept | {secants.trials[t].effects[-1] for t in members[row].tolist()})
        if key not in seen:
            seen.add(key)
            chosen.append(row)
            if key not in best or float(loss[row]) < best[key].loss:
                start = _start(secants, members[row], removed, share[row], moved[row])
                best[key] = Proposal(start, float(loss[row]))
        if len(chosen) == most:
            break
    return members[chosen]


def _start(
    secants: Secants, members: Tensor, removed: Sequence[int], share: Tensor, moved: Tensor
) -> Hypothesis:
    """What is left of the base, with the members, each at its share of its trial."""
    base, library = secants.base, secants.problem.library
    kept, numbers = secants.kept(removed), list(base.named().items())
    values = zip((numbers[i] for i in kept), moved.tolist(), strict=True)
    known = {key: z + b for (key, z), b in values}
    effects = [e for i, e in enumerate(base.effects) if i not in removed]
    for t, a in zip(members.tolist(), share.tolist(), strict=True):
        trial = secants.trials[t]
        effects.append(trial.effects[-1])
        own = {key: a * z for key, z in trial.named().items() if key[0] == trial.effects[-1]}
        known |= own
    start = library.at(effects, known)
    return start.at(start.vector)


SCREENED = 44  # segments, spread evenly, on which effects are screened
STAMPED = 0.05  # [prior scales of 0.01 s] clock offset below which it counts as none
FARTHEST_TRIAL = 1.5  # [-] times the way to a trial, along which the cost is minimised


def screened(
    problem: Problem, base: Fit, keep: int, at: Sequence[float] = TRIAL_SIZES
) -> list[Fit]:
    """The most promising starts: the base and one more effect each, at its best trial size."""
    rows = trials(problem, base, at)
    thin, [few] = thinned(problem, SCREENED, [base])
    best: dict[str, tuple[float, Fit]] = {}
    for trial in thin.rolled_out(rows):
        cost, name = promise(problem, few, trial), trial.effects[-1]
        if name not in best or cost < best[name][0]:
            best[name] = cost, trial
    ranked = sorted(best.values(), key=lambda item: item[0])
    return [trial for _, trial in ranked[:keep]]


def trials(problem: Problem, base: Fit, at: Sequence[float] = TRIAL_SIZES) -> list[Hypothesis]:
    """The base with one effect more, each that it has not, at every trial size."""
    others = [name for name in problem.library.names if name not in base.effects]
    return [start for name in others for start in _trials(problem, base, name, at)]


def _trials(
    problem: Problem, base: Fit, name: str, at: Sequence[float] = TRIAL_SIZES
) -> list[Hypothesis]:
    start = problem.library.hypothesis((*base.effects, name))
    kept, clock = base.vector[:-1], base.vector[-1:]
    # With the base's clock, and with a right one: without the effect, the clock may have taken
    # over a delay that is the effect's.
    taken = abs(float(clock)) > STAMPED and problem.library.may_delay(name)
    stamps = (clock, 0 * clock) if taken else (clock,)
    return [
        replace(start, vector=torch.cat([kept, torch.tensor(sizes, dtype=torch.float64), stamp]))
        for sizes in problem.library.trials(name, problem.segments, at)
        for stamp in stamps
    ]


def promise(problem: Problem, base: Fit, trial: Fit) -> float:
    """Loss [nats] at the best point between a base and a trial, along a straight line.

    r(t) = r_base + t P (r_trial - r_base), t in 0..1.5, with P projecting off what the base's own
    parameters absorb; or the trial itself, if that is better.
    """
    noise, dispersion = problem.noise, problem.dispersion
    move = trial.whitened - base.whitened  # (N, D)
    weight = noise.weight(base.square, dispersion).unsqueeze(-1)
    if base.jacobian is not None:
        jacobian = base.jacobian  # (N, D, P)
        normal = torch.einsum("ndp,ndq,ne->pq", jacobian, jacobian, weight)
        normal = normal + 1e-9 * torch.eye(len(normal), dtype=normal.dtype)
        along = torch.einsum("ndp,nd,ne->p", jacobian, move, weight)
        move = move - jacobian @ torch.linalg.solve(normal, along)
    curve = float((weight * move.square()).sum())
    share = -float((weight * move * base.whitened).sum()) / max(curve, 1e-12)
    share = min(max(share, 0.0), FARTHEST_TRIAL)
    square = (base.whitened + share * move).square().sum(-1)
    direct: Tensor = noise.loss(trial.square, dispersion).sum()
    return float(torch.minimum(direct, noise.loss(square, dispersion).sum()))


def thinned(problem: Problem, most: int, fits: Sequence[Fit]) -> tuple[Problem, list[Fit]]:
    """A problem on so many of its segments at most, spread evenly, and fits on the same ones."""
    count = len(problem.segments)
    rows = torch.linspace(0, count - 1, min(count, most)).round().long()
    return problem[rows], [fit[rows] for fit in fits]
