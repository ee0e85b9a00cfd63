"""The state of a search while it goes on, and what it came to under one noise model."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from buggy_rl.diagnosis.run.case import Criteria
from buggy_rl.diagnosis.search.candidate import Candidate, Effects, excess_misfit, leading
from buggy_rl.diagnosis.search.case_evidence import CaseEvidence
from buggy_rl.diagnosis.search.posterior import LISTED, Posterior
from buggy_rl.estimation.evidence import cross_validated, rewhitened
from buggy_rl.estimation.gauss_newton import Fit, Problem, fitted
from buggy_rl.estimation.hypothesis import Hypothesis
from buggy_rl.estimation.noise_model import NoiseModel, noise_model
from buggy_rl.estimation.rollout import Simulation

HALVES = 2  # groups of hypotheses; the same, whatever the number of processes
LEADING = 3  # hypotheses, of which each may be the truth


def held_out_loss(noise: NoiseModel, dispersion: float, candidate: Candidate) -> float:
    """Loss of a candidate on what was held out, with its prior penalty [nats]."""
    losses = noise.loss(candidate.cross_validated.square, dispersion)
    return float(losses.sum() + candidate.fit.penalty())


@dataclass(frozen=True, eq=False)
class SearchResult:
    """All hypotheses that were fitted, under one noise model and dispersion."""

    best: Candidate
    tried: Mapping[Effects, Candidate]
    noise: NoiseModel
    dispersion: float
    posterior: Posterior
    """Posterior of the sets that were fitted, of nothing, and of what no effect describes."""
    log_evidence: Mapping[Effects, float] = field(default_factory=dict)
    """Log evidence of each hypothesis [nats]."""
    varies: Mapping[str, str] = field(default_factory=dict)
    """Effect of the best hypothesis -> condition that its numbers vary with, where they do."""
    same: Mapping[Effects, Effects] = field(default_factory=dict)
    """Sets that are another one in other words (`limits`) -> that one, which has their share."""
    observed: CaseEvidence | None = None
    """What the posterior was computed from."""
    left_out: tuple[str, ...] = ()
    """Parts of the search for which there was no time, in words."""

    @property
    def null(self) -> Candidate:
        """The simulator as given, with its clock fitted."""
        return self.tried[()]

    @property
    def predictive(self) -> Candidate:
        """The set that predicts what was held out best, at `PRICE` nats an effect."""
        return leading(self.tried.values(), self.loss)

    @property
    def described(self) -> Candidate:
        """The set whose predictions stand for the car's.

        Where no effect describes what is missing, the most probable set of effects may predict
        little: there it is the one that predicts best.
        """
        return self.predictive if self.posterior.says == "unknown" else self.best

    @property
    def most_probable(self) -> list[Effects]:
        """The most probable hypotheses, of those that are listed; at most `LEADING`."""
        ranked = sorted(self.posterior.sets.items(), key=lambda item: -item[1])
        return [effects for effects, p in ranked[:LEADING] if p >= LISTED]

    def problem(self, problem: Problem) -> Problem:
        """The problem with the noise model and dispersion that the search came to."""
        return replace(problem, noise=self.noise, dispersion=self.dispersion)

    def loss(self, candidate: Candidate) -> float:
        """Loss on what was held out, with its prior penalty [nats]."""
        return held_out_loss(self.noise, self.dispersion, candidate)

    def without(self, effect: str) -> float:
        """Excess misfit without an effect, on what was held out."""
        key = tuple(sorted(set(self.best.effects) - {effect}))
        return excess_misfit(self.tried.get(key, self.null), self.null)

    def closed(self, effect: str) -> float:
        """Excess misfit that comes back without an effect; not below 0."""
        return max(0.0, self.without(effect) - excess_misfit(self.best, self.null))


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
        """Loss on what was held out, with its prior penalty [nats]."""
        return held_out_loss(self.problem.noise, self.problem.dispersion, candidate)

    def dispersed(self, dispersion: float) -> "State":
        """State under another dispersion, of at least 1."""
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
    tried, results = dict(state.tried), []
    leading = problem.cost(state.leading.fit) if state.tried else math.inf
    for candidate in _candidates(problem, starts, criteria, reference, leading):
        before = tried.get(candidate.key)
        if before is None or state.loss(candidate) < state.loss(before):
            tried[candidate.key] = candidate
        results.append(tried[candidate.key])
    return State(problem, tried), results


def _candidates(
    problem: Problem,
    starts: Sequence[Hypothesis],
    criteria: Criteria,
    reference: float | None,
    leading: float,
) -> list[Candidate]:
    """Hypotheses fitted and cross-validated, half of them in another process where there is one.

    A rollout of a few hundred environments takes hardly less than one of twice as many, so halves
    of the hypotheses are fitted beside each other, and not halves of each rollout.
    """
    simulation = problem.simulation
    groups = [number % HALVES for number in range(len(starts))]
    apart = HALVES if simulation.workers.count > 1 and len(starts) >= 2 * HALVES else 1
    tasks = [(starts[n::apart], groups[n::apart]) for n in range(apart)]
    alone = replace(problem, simulation=simulation.alone)
    own = replace(criteria, baseline=None)  # it is not asked, and a simulation may not be sent
    parts = simulation.apart(partial(_fitted_part, alone, own, reference, leading), tasks)
    return [parts[number % apart][number // apart] for number in range(len(starts))]


def _fitted_part(
    problem: Problem,
    criteria: Criteria,
    reference: float | None,
    leading: float,
    simulation: Simulation,
    starts: Sequence[Hypothesis],
    groups: Sequence[int],
) -> list[Candidate]:
    problem = replace(problem, simulation=simulation)
    fits = fitted(problem, starts, criteria.rules.iterations, reference, groups, leading)
    every = cross_validated(problem, fits, criteria.group, criteria.anew)
    return [Candidate(fit, known) for fit, known in zip(fits, every, strict=True)]


def renoised(state: State, best: Candidate, criteria: Criteria) -> State:
    """All hypotheses under the noise model linearised about the best one."""
    problem = state.problem
    settings = problem.library.settings([(best.fit, best.fit.vector)])
    noise = noise_model(problem.simulation, problem.segments, settings, extra=problem.noise.extra)
    change = noise.change_from(problem.noise)
    problem = replace(problem, noise=noise)
    tried = {}
    for key, candidate in state.tried.items():
        fit = candidate.fit.rewhitened(change)
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
