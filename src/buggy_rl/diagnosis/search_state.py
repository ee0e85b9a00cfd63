"""State of a search: what has been tried, under which noise model."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import torch

from buggy_rl.diagnosis.candidate import Candidate, Effects, leading
from buggy_rl.diagnosis.criteria import Criteria
from buggy_rl.diagnosis.search_result import held_out_loss
from buggy_rl.estimation.cross_validation import cross_validated, rewhitened
from buggy_rl.estimation.gauss_newton import Fit, Problem, fitted
from buggy_rl.estimation.hypothesis import Hypothesis
from buggy_rl.estimation.noise_model import noise_model

Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class State:
    """What a search has tried so far; each step returns another one."""

    problem: Problem
    tried: Mapping[Effects, Candidate]

    @property
    def null(self) -> Candidate:
        """The simulator as given, with its clock fitted."""
        return self.tried[()]

    @property
    def leading(self) -> Candidate:
        """The best so far: held-out loss, and a price for each effect."""
        return leading(self.tried.values(), self.loss)

    def loss(self, candidate: Candidate) -> float:
        """On what was held out, with its prior penalty [nats]."""
        return held_out_loss(self.problem.noise, self.problem.dispersion, candidate)

    def dispersed(self, dispersion: float) -> "State":
        """Under another dispersion, of at least 1."""
        return replace(self, problem=replace(self.problem, dispersion=max(1.0, dispersion)))


def tried_too(
    state: State,
    starts: Sequence[Hypothesis],
    criteria: Criteria,
    base: Candidate | None = None,
) -> tuple[State, list[Candidate]]:
    """Fits and cross-validates hypotheses; of two with the same effects the better one is kept.

    Args:
        state: So far.
        starts: Where each begins.
        criteria: Blocks and iterations.
        base: What they are to be better than, where only the better ones matter.
    """
    if not starts:
        return state, []
    problem = state.problem
    reference = None if base is None else problem.cost(base.fit)
    fits = fitted(problem, starts, criteria.rules.iterations, reference)
    tried, results = dict(state.tried), []
    every = cross_validated(problem, fits, criteria.group, criteria.anew)
    for fit, known in zip(fits, every, strict=True):
        candidate = Candidate(fit, known)
        before = tried.get(candidate.key)
        if before is None or state.loss(candidate) < state.loss(before):
            tried[candidate.key] = candidate
        results.append(tried[candidate.key])
    return State(problem, tried), results


def renoised(state: State, best: Candidate, criteria: Criteria) -> State:
    """All hypotheses under the noise model linearised about the best one."""
    problem = state.problem
    settings = problem.library.settings([(best.fit, best.fit.vector)])
    noise = noise_model(problem.simulation, problem.segments, settings, extra=problem.noise.extra)
    change = noise.change_from(problem.noise)
    problem = replace(problem, noise=noise)
    tried = {}
    for key, candidate in state.tried.items():
        fit, jacobian = candidate.fit, candidate.fit.jacobian
        whitened = torch.einsum("nij,nj->ni", change, fit.whitened)
        jacobian = None if jacobian is None else change @ jacobian
        fit = replace(fit, whitened=whitened, jacobian=jacobian)
        known = rewhitened(problem, fit, candidate.cross_validated, change, criteria.group)
        tried[key] = Candidate(fit, known)
    return State(problem, tried)


def restarts(fit: Fit, offsets: Sequence[float]) -> list[Hypothesis]:
    """A fit with a right clock, and with one of its numbers moved by each of the offsets."""
    vectors = [fit.vector.clone()]
    vectors[0][-1] = 0.0
    for index in range(len(fit.vector) - 1):
        for offset in offsets:
            vectors.append(fit.vector.clone())
            vectors[-1][index] += offset
    return [fit.at(vector) for vector in vectors]


def restarted(problem: Problem, fit: Fit, rolled: Sequence[Fit]) -> Fit:
    """The best of the rollouts of `restarts` if it is better than the fit, else the first."""
    found = min(rolled, key=problem.cost)
    return found if problem.cost(found) < problem.cost(fit) else rolled[0]
