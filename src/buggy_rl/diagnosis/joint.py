"""Joint search: all effects in one batch of rollouts; promising sets are fitted and weighed."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from buggy_rl.diagnosis.candidate import Candidate, Effects
from buggy_rl.diagnosis.constancy import conditions
from buggy_rl.diagnosis.search import State, tried_too
from buggy_rl.diagnosis.selection import Criteria
from buggy_rl.estimation.evidence import Evidence, evidence
from buggy_rl.estimation.gauss_newton import Fit, Problem
from buggy_rl.estimation.screening import trials
from buggy_rl.estimation.sparse import Proposal, Secants, proposals

FITTED = {1: 6, 2: 6, 3: 4}  # effects of a set -> sets of that size that are fitted


@dataclass(frozen=True, eq=False)
class Weighed:
    """A fitted hypothesis and its evidence."""

    candidate: Candidate
    evidence: Evidence


@dataclass(frozen=True, eq=False)
class JointSearch:
    """What a joint search came to."""

    problem: Problem
    null: Candidate
    """The simulator as given, with its clock fitted."""
    weighed: list[Weighed]
    """The most evident first; the simulator as given among them."""
    proposed: list[Proposal]
    """All sets, by the loss of their superposition."""

    def rank(self, effects: Effects) -> int:
        """Place of a set among the proposed ones of its size, from 1; 0 where it is not."""
        same = [p.key for p in self.proposed if len(p.key) == len(effects)]
        return same.index(effects) + 1 if effects in same else 0


def joint_search(problem: Problem, criteria: Criteria, also: Sequence[Effects] = ()) -> JointSearch:
    """Finds sets of effects by the superposition of their secants, fits and weighs the best.

    Args:
        problem: Simulator and segments.
        criteria: Blocks and iterations.
        also: Sets that are fitted whether they are promising or not.
    """
    rules = criteria.rules
    state, [null] = tried_too(State(problem, {}), [problem.library.hypothesis(())], criteria)
    state = state.dispersed(rules.expected_left * null.typical)
    rolled = state.problem.rolled_out(trials(state.problem, null.fit))
    proposed = proposals(Secants.of(state.problem, null.fit, rolled), max(FITTED), also)
    starts = [p for size, most in FITTED.items() for p in _of_size(proposed, size)[:most]]
    starts += [p for p in proposed if p.key in map(_sorted, also) and p not in starts]
    state, _ = tried_too(state, [p.start for p in starts], criteria)
    instants = problem.simulation.instants(problem.segments)
    driven = torch.stack(list(conditions(problem.segments, instants).values()), -1)
    owners, changes = unit_changes(null.fit, rolled)
    weighed = []
    for candidate in state.tried.values():
        others = [i for i, owner in enumerate(owners) if owner not in candidate.effects]
        weighed.append(Weighed(candidate, evidence(candidate.fit, changes[..., others], driven)))
    weighed.sort(key=lambda w: -w.evidence.log_evidence)
    return JointSearch(state.problem, state.null, weighed, proposed)


def _sorted(effects: Effects) -> Effects:
    return tuple(sorted(effects))


def _of_size(proposed: Sequence[Proposal], size: int) -> list[Proposal]:
    return [p for p in proposed if len(p.key) == size]


def unit_changes(base: Fit, rolled: Sequence[Fit]) -> tuple[list[str], Tensor]:
    """Change of the whitened residuals by one prior scale of each way an effect may go.

    Of trials in the same direction the smallest counts; each place of a patch is one.

    Returns:
        Effect of each column, and columns [N, D, Q].
    """
    smallest: dict[tuple, tuple[float, Tensor]] = {}
    for trial in rolled:
        own = [i for i, c in enumerate(trial.coordinates) if c.effect == trial.effects[-1]]
        vector = trial.vector[own]
        size = float(vector.norm())
        side = math.copysign(size, next(z for z in vector.tolist() if z))
        direction = tuple(round(z / side, 6) for z in vector.tolist())  # both ways are one
        key = trial.effects[-1], direction
        if key not in smallest or size < smallest[key][0]:
            smallest[key] = size, (trial.whitened - base.whitened) / size
    return [effect for effect, _ in smallest], torch.stack([c for _, c in smallest.values()], -1)
