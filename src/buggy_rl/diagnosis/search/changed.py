"""Evidence of a set of effects beside what simulator and car differ in anyway.

No simulator is its car, and no car is the same in each recording. With a column m_q for each way of
each effect, and for the clock, the whitened residuals of a block g of 8 s are

    r_g + M_g (b + u_g) = n             of the baseline,
    r_g(z) + J_g d + M_g (b + u_g) = n  of the recordings, with a set fitted at z,
    b ~ N(0, 1),  u_g ~ N(0, diag tau^2),  d ~ N(-z, prior^2),  n ~ N(0, phi / w)

b is what the simulator lacks of every effect, tau how much that differs from block to block of
baseline and recordings, d what has changed. Integrated over u, b and d (Laplace): what the baseline
shows too, or what differs from block to block as much, is no evidence of a change. Without a
baseline b ~ N(0, UNSEEN^2).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from buggy_rl.diagnosis.search.ways import Way, unit_changes, way_of
from buggy_rl.estimation.evidence import blocks
from buggy_rl.estimation.gauss_newton import Fit, Problem
from buggy_rl.estimation.hypothesis import Hypothesis
from buggy_rl.estimation.information import Information, by_block
from buggy_rl.estimation.sparse import trials

SIZE = (0.4,)  # [prior scales] of the trials whose secants are the columns
FREE = 1.5  # [prior scales] standard deviation of a group's mean, while tau is estimated
STEPS = 40  # of expectation and maximisation
BEGUN = 0.3  # [prior scales] tau before the first of them
UNSEEN = 0.1  # [prior scales] standard deviation of b where no baseline tells it
LEAST = 1e-3  # [prior scales] deviation from block to block, at least
DRAWN = 1.5  # [prior scales] standard deviation of a change, where sets are only proposed
REWEIGHTED = 4  # times
BEAM = 12  # sets of one size that are extended
CLOCK: Way = ("", (1.0,))  # the clock among the columns


def variance_of(groups: Sequence[Information]) -> Tensor:
    """tau^2 [Q] of numbers from block to block, about a mean of each group of blocks.

    By expectation and maximisation (Dempster, Laird, Rubin 1977), tau_q^2 <- mean E[u_gq^2]: of
    numbers that do the same, those that do it best come to deviate, and the others not.
    """
    tau2 = torch.full_like(groups[0].score[0], BEGUN**2)
    for _ in range(STEPS):
        squares = [_expected_squares(group, 1 / tau2) for group in groups]
        tau2 = torch.cat(squares).mean(0).clamp_min(LEAST**2)
    return tau2


def _expected_squares(group: Information, precision: Tensor) -> Tensor:
    """E[u^2] [G, Q] of deviations, integrated over their group's mean."""
    own = torch.linalg.inv(group.hessian + torch.diag(precision))  # (G, Q, Q)
    seen = own @ group.hessian
    mean = group.hessian - group.hessian @ seen
    score = group.score - (seen.mT @ group.score.unsqueeze(-1)).squeeze(-1)
    one = torch.eye(len(precision), dtype=precision.dtype)
    spread = torch.linalg.inv(mean.sum(0) + one / FREE**2)
    common = -spread @ score.sum(0)
    along = group.score + group.hessian @ common
    deviation = -(own @ along.unsqueeze(-1)).squeeze(-1)
    variance = own.diagonal(dim1=1, dim2=2) + ((seen @ spread) * seen).sum(-1)
    return deviation.square() + variance


@dataclass(frozen=True, eq=False)
class Usual:
    """What a simulator lacks on its baseline, as numbers of every effect and the clock."""

    ways: list[Way]
    """Q effects and directions; the clock last."""
    of_blocks: Information | None
    """Normal equations of the numbers of each block of the baseline; None without one."""
    dispersion: float
    """[noise variances] of the simulator there."""

    def common(self, numbers: Sequence[int], variance: Tensor) -> Information:
        """Normal equations of b, with its prior, of some of the numbers with tau^2 [Q]."""
        one = torch.eye(len(numbers), dtype=torch.float64)
        if self.of_blocks is None:
            return Information(one / UNSEEN**2, torch.zeros_like(variance))
        own = self.of_blocks.of(numbers)
        left = own.without(0, own.factor(0, 1 / variance)[0]).total()
        return Information(left.hessian + one, left.score)


def usual(baseline: Problem) -> Usual:
    """What is usual on a baseline.

    Args:
        baseline: Segments on which the simulator counts as right.
    """
    null = baseline.rolled_out([baseline.library.hypothesis(())], True)[0]
    ways, changes = unit_changes(null, baseline.rolled_out(trials(baseline, null, SIZE)))
    columns = _with_clock(changes, null)
    dispersion = max(1.0, float((null.square / baseline.noise.dimension).median()))
    _, block = blocks(baseline.segments).unique(return_inverse=True)
    weight = baseline.noise.weight(null.square, dispersion) / dispersion
    of_blocks = by_block(columns, null.whitened, weight, block)
    return Usual([*ways, CLOCK], of_blocks, dispersion)


@dataclass(frozen=True, eq=False)
class Changed:
    """What has changed since a baseline; without one, what the car has that its simulator lacks."""

    problem: Problem
    """The recordings, under the dispersion of the baseline."""
    block: Tensor
    """[N] 0 to G - 1."""
    ways: list[Way]
    """Ways, Q of them, that baseline and recordings have in common; the clock last."""
    columns: Tensor
    """[N, D, Q]"""
    variance: Tensor
    """[Q]"""
    common: Information
    """Normal equations of b, from the baseline."""
    own: Information
    """Normal equations of the numbers of each block, about the simulator as given."""

    @classmethod
    def since(
        cls,
        known: Usual | None,
        problem: Problem,
        group: Tensor,
        null: Fit,
        changes: tuple[list[Way], Tensor],
    ) -> "Changed":
        """What has changed since a baseline was recorded.

        Numbers deviate alike in all blocks, of baseline and recordings: a simulator is closer to
        what it was fitted to, so that the baseline alone would tell too little.

        Args:
            known: What is usual on the baseline; None without one.
            problem: The recordings.
            group: [N] blocks.
            null: The simulator as given, with its derivative by the clock.
            changes: By one prior scale of each way of each effect, of `unit_changes`.
        """
        ways = [*changes[0], CLOCK]
        known = known or Usual(ways, None, 1.0)
        both = [way for way in ways if way in known.ways]
        there = [known.ways.index(way) for way in both]
        columns = _with_clock(changes[1], null)[..., [ways.index(way) for way in both]]
        problem = replace(problem, dispersion=known.dispersion)
        _, block = group.unique(return_inverse=True)
        weight = problem.noise.weight(null.square, known.dispersion) / known.dispersion
        own = by_block(columns, null.whitened, weight, block)
        before = [] if known.of_blocks is None else [known.of_blocks.of(there)]
        variance = variance_of([*before, own])
        common = known.common(there, variance)
        return cls(problem, block, both, columns, variance, common, own)

    def log_evidence(self, fits: Sequence[Fit]) -> list[float]:
        """Log evidence [nats] of fitted sets, less that of the best of them.

        Under the dispersion of the baseline, or of what the best of them leaves where that is more.
        """
        found = [self._of(fit) for fit in fits]
        size = self.problem.noise.dimension
        left = min((float((square / size).median()) for _, square in found), default=0.0)
        if left > self.problem.dispersion:
            wider = replace(self, problem=replace(self.problem, dispersion=left))
            found = [wider._of(fit) for fit in fits]
        most = max((total for total, _ in found), default=0.0)
        return [total - most for total, _ in found]

    def _of(self, fit: Fit) -> tuple[float, Tensor]:
        """Log evidence of a fitted set, and the square [N] that is left.

        By Laplace's method about the most probable b, u and d, for which segments are weighed anew
        as often as `REWEIGHTED`.
        """
        assert fit.jacobian is not None
        columns = torch.cat([fit.jacobian, self.columns], -1)
        square, total = fit.square, 0.0
        for _ in range(REWEIGHTED):
            total, square = self._integrated(fit, columns, square)
        return total, square

    def _integrated(self, fit: Fit, columns: Tensor, square: Tensor) -> tuple[float, Tensor]:
        """Log evidence about the most probable numbers, segments weighed by a square [N].

        Args:
            fit: The set.
            columns: [N, D, P + Q] of d, then of b.
            square: [N]

        Returns:
            Log evidence, and the square [N] that is left.
        """
        problem, own = self.problem, len(fit.coordinates)
        noise, dispersion, precision = problem.noise, problem.dispersion, 1 / self.variance
        weight = noise.weight(square, dispersion) / dispersion
        of_blocks = by_block(columns, fit.whitened, weight, self.block)
        factor, volume = of_blocks.factor(own, precision)
        both = of_blocks.without(own, factor).total()
        both.hessian[own:, own:] += self.common.hessian
        both.score[own:] += self.common.score
        both.hessian[:own, :own] += torch.diag(fit.prior**-2)
        both.score[:own] += fit.vector / fit.prior**2
        root = torch.linalg.cholesky(both.hessian)
        x = -torch.cholesky_solve(both.score.unsqueeze(-1), root).squeeze(-1)
        u = of_blocks.deviations(own, factor, x)  # (G, Q)
        left = fit.whitened + columns @ x + (self.columns @ u[self.block].unsqueeze(-1)).squeeze(-1)
        square, b = left.square().sum(-1), x[own:]
        loss = noise.loss(square, dispersion).sum()
        loss = loss + 0.5 * ((fit.vector + x[:own]) / fit.prior).square().sum()
        loss = loss + 0.5 * (precision * u.square()).sum()
        loss = loss + 0.5 * b @ self.common.hessian @ b + self.common.score @ b
        volume = volume + root.diagonal().log().sum() + fit.prior.log().sum()
        return -float(loss + volume), square

    def proposed(
        self, null: Fit, rolled: Sequence[Fit], most: Mapping[int, int]
    ) -> list[Hypothesis]:
        """Sets by their evidence to first order about the simulator as given, each at its numbers.

        Args:
            null: The simulator as given.
            rolled: Trials of one effect each, of which the columns are the secants.
            most: Effects of a set -> sets of that size, at most.
        """
        change = self._to_first_order()
        effects = [effect for effect, _ in self.ways]
        at = {way: i for i, way in enumerate(self.ways)}
        begin = {at[way]: trial for trial in rolled if (way := way_of(trial)[0]) in at}
        members = torch.zeros(1, 0, dtype=torch.long)
        found: list[Hypothesis] = []
        for size in range(1, max(most) + 1):
            members = _one_more(members, effects)
            gain, numbers = _gained(change, members)
            best: dict[frozenset[str], int] = {}
            for row in gain.argsort(descending=True).tolist():
                key = frozenset(effects[i] for i in members[row].tolist())
                if len(key) == size:  # else two ways of one effect
                    best.setdefault(key, row)
            rows = list(best.values())[:BEAM]
            for row in rows[: most.get(size, 0)]:
                found.append(self._begun(null, begin, members[row], numbers[row]))
            members = members[rows]
        return found

    def _to_first_order(self) -> Information:
        """Normal equations of a change of each number, the common ones integrated over."""
        factor, _ = self.own.factor(0, 1 / self.variance)
        here = self.own.without(0, factor).total()
        seen = here.hessian @ torch.linalg.inv(here.hessian + self.common.hessian)
        score = here.score - seen @ (here.score + self.common.score)
        return Information(here.hessian - seen @ here.hessian, score)

    def _begun(
        self, null: Fit, begin: Mapping[int, Fit], members: Tensor, numbers: Tensor
    ) -> Hypothesis:
        known, effects = null.named(), []
        for i, amount in zip(members.tolist(), numbers.tolist(), strict=True):
            trial, (effect, _) = begin[i], self.ways[i]
            _, size = way_of(trial)
            own = {k: z * amount / size for k, z in trial.named().items() if k[0] == effect}
            known |= own
            effects.append(effect)
        start = self.problem.library.at(effects, known)
        return start.at(start.vector)


def _with_clock(changes: Tensor, null: Fit) -> Tensor:
    """Columns [N, D, Q] with that of the clock as the last."""
    assert null.jacobian is not None
    return torch.cat([changes, null.jacobian[..., -1:]], -1)


def _one_more(members: Tensor, effects: Sequence[str]) -> Tensor:
    """Sets [C, k] with one way more each, [C', k + 1]; the clock, which is last, is none."""
    every = torch.arange(len(effects) - 1)
    more = every.repeat(len(members)).unsqueeze(1)
    return torch.cat([members.repeat_interleave(len(every), 0), more], 1)


def _gained(change: Information, members: Tensor) -> tuple[Tensor, Tensor]:
    """Evidence [C] of changes of some numbers [C, k] alone, and their estimates [C, k]."""
    k = members.shape[1]
    own = change.hessian[members.unsqueeze(2), members.unsqueeze(1)]
    own = own + torch.eye(k, dtype=own.dtype) * DRAWN**-2
    score = change.score[members].unsqueeze(-1)
    factor = torch.linalg.cholesky(own)
    numbers = -torch.cholesky_solve(score, factor)
    volume = factor.diagonal(dim1=1, dim2=2).log().sum(-1) + k * math.log(DRAWN)
    return -0.5 * (score * numbers).sum((1, 2)) - volume, numbers.squeeze(-1)
