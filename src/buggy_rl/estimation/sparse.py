"""Sparse search by linear algebra: which sets of trials would close a residual together.

Each trial is a rollout of the base with one effect more; its secant is the change of the whitened
residuals. To first order effects add up, so one batch of rollouts tells of every pair and triple
what would remain. What is found is a place to start a fit, not an answer.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from buggy_rl.estimation.gauss_newton import Fit, Problem
from buggy_rl.estimation.hypothesis import Hypothesis

FARTHEST = 1.5  # [-] times its trial size that an effect may have
REWEIGHTED = 4  # times that heavy-tailed weights are computed anew
BEAM = 200  # sets of one size that are extended
CHUNK = 20_000  # sets that are solved at once, to bound memory
FIXED = 1e12  # [-] precision of a coefficient that is held at its bound


@dataclass(frozen=True)
class Proposal:
    """A set of effects, and where its fit should begin."""

    start: Hypothesis
    loss: float
    """Of the superposition, with its prior penalty [nats]."""

    @property
    def key(self) -> tuple[str, ...]:
        """Its effects, sorted."""
        return tuple(sorted(self.start.effects))


@dataclass(frozen=True, eq=False)
class Secants:
    """Superposition of the secants of trials about a base."""

    problem: Problem
    base: Fit
    trials: Sequence[Fit]
    """Rollouts of the base with one more effect each, the last of its effects."""
    gram: Tensor
    """[N, M, M] products of (residual, T moves, P derivatives of the base) of each segment."""

    @classmethod
    def of(cls, problem: Problem, base: Fit, trials: Sequence[Fit]) -> "Secants":
        """From rollouts of the trials; the base has its derivatives."""
        assert base.jacobian is not None
        moves = torch.stack([t.whitened - base.whitened for t in trials], -1)  # (N, D, T)
        columns = torch.cat([base.whitened.unsqueeze(-1), moves, base.jacobian], -1)
        return cls(problem, base, trials, columns.mT @ columns)

    def solved(self, members: Tensor, fixed: Sequence[int] = ()) -> tuple[Tensor, Tensor, Tensor]:
        """Least loss of each set of trials, and its coefficients.

        r = r_base + sum a_t m_t + J b,  0 <= a <= `FARTHEST`, by reweighted least squares.

        Args:
            members: [C, k] indices of trials.
            fixed: Coordinates of the base that are brought to neutral.

        Returns:
            Losses [C], a [C, k] and b [C, P].
        """
        parts = [self._solved(part, fixed) for part in members.split(CHUNK)]
        return tuple(torch.cat(p) for p in zip(*parts, strict=True))  # type: ignore[return-value]

    def _solved(self, members: Tensor, fixed: Sequence[int]) -> tuple[Tensor, Tensor, Tensor]:
        noise, phi = self.problem.noise, self.problem.dispersion
        count, k = members.shape
        own = len(self.base.coordinates)
        first = 1 + len(self.trials)
        columns = torch.cat(
            [1 + members, torch.arange(first, first + own).expand(count, own)], 1
        )  # (C, R)
        gram = self.gram[:, columns.unsqueeze(2), columns.unsqueeze(1)].movedim(0, 1)  # (C,N,R,R)
        along = self.gram[:, 0][:, columns].movedim(0, 1)  # (C, N, R)
        left = self.gram[:, 0, 0]  # (N,)
        precision, centre = self._prior(members)
        low = torch.full_like(centre, -torch.inf)
        high = torch.full_like(centre, torch.inf)
        low[:, :k], high[:, :k] = 0.0, FARTHEST
        for index in fixed:
            low[:, k + index] = high[:, k + index] = -self.base.vector[index]
        held, value = low == high, torch.where(low == high, low, torch.zeros_like(low))
        square = left.expand(count, -1)
        solution = torch.zeros_like(centre)
        for _ in range(REWEIGHTED):
            weight = noise.weight(square, phi) / phi  # (C, N)
            hessian = torch.einsum("cnrs,cn->crs", gram, weight)
            score = torch.einsum("cnr,cn->cr", along, weight) - precision * centre
            hessian = hessian + torch.diag_embed(precision)
            now, at = held, value
            for _ in range(2):
                stiff = torch.where(now, FIXED, 0.0)
                full = hessian + torch.diag_embed(stiff)
                solution = torch.linalg.solve(full, stiff * at - score)
                out = (solution < low) | (solution > high)
                now = now | out
                at = torch.where(out, solution.clamp(low, high), at)
            solution = solution.clamp(low, high)
            square = (
                left
                + 2 * torch.einsum("cnr,cr->cn", along, solution)
                + torch.einsum("cnrs,cr,cs->cn", gram, solution, solution)
            ).clamp_min(0.0)
        loss = noise.loss(square, phi).sum(-1)
        loss = loss + 0.5 * (precision * (solution - centre).square()).sum(-1)
        return loss, solution[:, :k], solution[:, k:]

    def _prior(self, members: Tensor) -> tuple[Tensor, Tensor]:
        """Precision and centre [C, k + P] of the coefficients."""
        sizes = []
        for trial in self.trials:
            own = [i for i, c in enumerate(trial.coordinates) if c.effect == trial.effects[-1]]
            sizes.append((trial.vector[own] / trial.prior[own]).square().sum())
        base = self.base.prior**-2
        precision = torch.cat(
            [torch.stack(sizes)[members], base.expand(len(members), -1)], 1
        ).clamp_min(1e-9)
        centre = torch.zeros_like(precision)
        centre[:, members.shape[1] :] = -self.base.vector
        return precision, centre


def proposals(
    secants: Secants, most: int, price: float, without: Sequence[str] = ()
) -> list[Proposal]:
    """The best sets of at most `most` more effects, the most promising first.

    Args:
        secants: Of trials about a base.
        most: Effects that are added at most.
        price: Of an effect [nats].
        without: Effects of the base that are left out.
    """
    base, problem = secants.base, secants.problem
    fixed = [i for i, c in enumerate(base.coordinates) if c.effect in without]
    names = [trial.effects[-1] for trial in secants.trials]
    number = {name: i for i, name in enumerate(dict.fromkeys(names))}
    effect = torch.tensor([number[name] for name in names])
    best: dict[frozenset[str], tuple[float, Proposal]] = {}
    kept = frozenset(base.effects) - set(without)
    members = torch.arange(len(names)).unsqueeze(1)
    for size in range(1, most + 1):
        loss, share, moved = secants.solved(members, fixed)
        order = loss.argsort()
        chosen = []
        for row in order[: 20 * BEAM].tolist():
            key = kept | {names[t] for t in members[row].tolist()}
            if key in best:
                continue
            start = _start(
                problem, base, secants.trials, members[row], share[row], moved[row], kept
            )
            cost = float(loss[row])
            best[key] = cost + price * len(key), Proposal(start, cost)
            chosen.append(row)
            if len(chosen) == BEAM:
                break
        if size == most:
            break
        head = members[chosen]  # (B, k)
        more = torch.arange(len(names))
        grown = torch.cat(
            [
                head.repeat_interleave(len(more), 0),
                more.repeat(len(head)).unsqueeze(1),
            ],
            1,
        )
        clash = (effect[grown[:, :-1]] == effect[grown[:, -1:]]).any(1)
        members = grown[~clash]
    return [p for _, p in sorted(best.values(), key=lambda item: item[0])]


def _start(problem, base, trials, members, share, moved, kept) -> Hypothesis:
    known = {
        key: z + float(b)
        for (key, z), b in zip(base.named().items(), moved.tolist(), strict=True)
        if key[0] in kept or not key[0]
    }
    effects = [e for e in base.effects if e in kept]
    for t, a in zip(members.tolist(), share.tolist(), strict=True):
        trial = trials[t]
        effects.append(trial.effects[-1])
        known |= {
            (c.effect, c.parameter.name): a * z
            for c, z in zip(trial.coordinates, trial.vector.tolist(), strict=True)
            if c.effect == trial.effects[-1]
        }
    start = problem.library.at(effects, known)
    return start.at(start.vector)
