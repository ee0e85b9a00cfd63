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

    def solved(self, members: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Least loss of each set of trials, and its coefficients.

        r = r_base + sum a_t m_t + J b,  0 <= a <= `FARTHEST`, by reweighted least squares.

        Args:
            members: [C, k] indices of trials.

        Returns:
            Losses [C], a [C, k] and b [C, P].
        """
        parts = [self._solved(part) for part in members.split(CHUNK)]
        return tuple(torch.cat(p) for p in zip(*parts, strict=True))  # type: ignore[return-value]

    def _solved(self, members: Tensor) -> tuple[Tensor, Tensor, Tensor]:
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
        square = left.expand(count, -1)
        solution = torch.zeros_like(centre)
        for _ in range(REWEIGHTED):
            weight = noise.weight(square, phi) / phi  # (C, N)
            hessian = torch.einsum("cnrs,cn->crs", gram, weight)
            score = torch.einsum("cnr,cn->cr", along, weight) - precision * centre
            hessian = hessian + torch.diag_embed(precision)
            now, at = torch.zeros_like(centre, dtype=torch.bool), torch.zeros_like(centre)
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


def proposals(secants: Secants, most: int, also: Sequence[Sequence[str]] = ()) -> list[Proposal]:
    """The best sets of at most `most` more effects, the most promising first.

    Args:
        secants: Of trials about a base.
        most: Effects that are added at most.
        also: Sets that are proposed too, whether they are promising or not.
    """
    names = [trial.effects[-1] for trial in secants.trials]
    number = {name: i for i, name in enumerate(dict.fromkeys(names))}
    effect = torch.tensor([number[name] for name in names])
    every = torch.arange(len(names))
    best: dict[frozenset[str], Proposal] = {}
    members = every.unsqueeze(1)
    for size in range(1, most + 1):
        chosen = _best(secants, members, best, BEAM)
        if size < most:
            grown = [members[chosen].repeat_interleave(len(every), 0), every.repeat(len(chosen))]
            members = torch.cat([grown[0], grown[1].unsqueeze(1)], 1)
            members = members[~(effect[members[:, :-1]] == effect[members[:, -1:]]).any(1)]
    for names_of in also:
        own = [every[effect == number[name]] for name in names_of]
        if own:
            _best(secants, torch.cartesian_prod(*own).reshape(-1, len(own)), best, 1)
    return sorted(best.values(), key=lambda proposal: proposal.loss)


def _best(
    secants: Secants, members: Tensor, best: dict[frozenset[str], Proposal], most: int
) -> list[int]:
    """Rows of the best sets that are not in `best` yet, each of its own effects; enters them."""
    loss, share, moved = secants.solved(members)
    chosen: list[int] = []
    for row in loss.argsort().tolist():
        key = frozenset(secants.trials[t].effects[-1] for t in members[row].tolist())
        if key not in best:
            start = _start(secants, members[row], share[row], moved[row])
            best[key] = Proposal(start, float(loss[row]))
            chosen.append(row)
        if len(chosen) == most:
            break
    return chosen


def _start(secants: Secants, members: Tensor, share: Tensor, moved: Tensor) -> Hypothesis:
    """The base with the members, each at its share of its trial."""
    base, library = secants.base, secants.problem.library
    values = zip(base.named().items(), moved.tolist(), strict=True)
    known = {key: z + b for (key, z), b in values}
    effects = list(base.effects)
    for t, a in zip(members.tolist(), share.tolist(), strict=True):
        trial = secants.trials[t]
        effects.append(trial.effects[-1])
        own = {key: a * z for key, z in trial.named().items() if key[0] == trial.effects[-1]}
        known |= own
    start = library.at(effects, known)
    return start.at(start.vector)
