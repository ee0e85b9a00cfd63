"""Search: forward selection with elimination and pruning, over frozen hypotheses."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from buggy_rl.diagnosis.candidate import Candidate, Effects, excess_misfit
from buggy_rl.diagnosis.search_result import SearchResult, held_out_loss
from buggy_rl.diagnosis.selection import Criteria, accepted
from buggy_rl.estimation.cross_validation import cross_validated
from buggy_rl.estimation.gauss_newton import Fit, Problem, fitted
from buggy_rl.estimation.hypothesis import Hypothesis
from buggy_rl.estimation.noise_model import noise_model
from buggy_rl.estimation.screening import screened

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

    def loss(self, candidate: Candidate) -> float:
        """On what was held out, with its prior penalty [nats]."""
        return held_out_loss(self.problem.noise, self.problem.dispersion, candidate)

    def dispersed(self, dispersion: float) -> "State":
        """Under another dispersion, of at least 1."""
        return replace(self, problem=replace(self.problem, dispersion=max(1.0, dispersion)))


Step = tuple[State, Candidate]


def search(
    problem: Problem, criteria: Criteria, progress: Progress = lambda _: None
) -> SearchResult:
    """Finds the best hypothesis, and all alternatives that came close.

    1. Fit the simulator as given.
    2. Screen, fit and accept the effect that predicts best; eliminate what is not needed any more;
       re-linearise the noise model about the result; repeat.
    3. Prune effects that close less than what remains.
    """
    rules = criteria.rules
    state, [best] = tried_too(State(problem, {}), [problem.library.hypothesis(())], criteria)
    while len(best.effects) < rules.most_effects:
        # What the best leaves so far is no noise: so much less does a nat count.
        state = state.dispersed(rules.expected_left * best.typical)
        state, step = extended(state, best, criteria, progress)
        if step is None:
            state, step = warm_started(state, best, criteria)
        else:
            state, step = eliminated(state, step, criteria)
        if step is None:
            break
        state, best = relinearised(state, step, criteria)
    state, pruned_best = pruned(state, best, criteria)
    if pruned_best.key != best.key:  # it was fitted on the way, and not to the end
        state, best = relinearised(state, pruned_best, criteria)
    return SearchResult(best, state.tried, state.problem.noise, max(1.0, best.typical))


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
    for fit, known in zip(fits, cross_validated(problem, fits, criteria.group), strict=True):
        candidate = Candidate(fit, known)
        before = tried.get(candidate.key)
        if before is None or state.loss(candidate) < state.loss(before):
            tried[candidate.key] = candidate
        results.append(tried[candidate.key])
    return State(problem, tried), results


def extended(
    state: State, base: Candidate, criteria: Criteria, progress: Progress
) -> tuple[State, Candidate | None]:
    """The base with the effect that helps most; None when none is accepted."""
    rules, problem = criteria.rules, state.problem
    progress(f"screening {len(problem.library.names)} effects")
    keep = rules.screened_further if base.effects else rules.screened_first
    starts = screened(problem, base.fit, keep)
    progress(f"fitting {len(starts)} hypotheses")
    state, results = tried_too(state, starts, criteria, base)
    helping = [c for c in results if accepted(criteria, problem, c, base, state.null)]
    return state, min(helping, key=state.loss, default=None)


def eliminated(state: State, candidate: Candidate, criteria: Criteria) -> Step:
    """Leaves out effects that are not needed any more."""
    while len(candidate.effects) > 1:
        state, fewer = without_one(state, candidate, criteria)
        needless = [
            less
            for less in fewer
            if not accepted(criteria, state.problem, candidate, less, state.null)
        ]
        if not needless:
            break
        candidate = min(needless, key=state.loss)
    return state, candidate


def pruned(state: State, candidate: Candidate, criteria: Criteria) -> Step:
    """Leaves out effects that close less than what remains, the least first.

    What no equation closes resembles many of them a little: an effect that is smaller than that is
    as likely a part of it as an effect.
    """
    while len(candidate.effects) > 1:
        null = state.null
        rest = excess_misfit(candidate, null) - criteria.usual.mean
        state, fewer = without_one(state, candidate, criteria)
        less = min(fewer, key=lambda c: excess_misfit(c, null))
        if excess_misfit(less, null) - excess_misfit(candidate, null) > max(rest, 0.0):
            break
        candidate = less
    return state, candidate


def without_one(
    state: State, candidate: Candidate, criteria: Criteria
) -> tuple[State, list[Candidate]]:
    """The same without each of its effects, fitted."""
    known, starts = [], []
    for left_out in candidate.effects:
        keep = tuple(e for e in candidate.effects if e != left_out)
        before = state.tried.get(tuple(sorted(keep)))
        if before is not None:
            known.append(before)
        else:
            starts.append(state.problem.library.at(keep, candidate.fit.named()))
    state, results = tried_too(state, starts, criteria)
    return state, known + results


def relinearised(state: State, best: Candidate, criteria: Criteria) -> Step:
    """Re-linearises the noise model about the best hypothesis and polishes its fit.

    Start errors grow differently in the repaired simulator: on a slippery floor a car spins, or
    not, by a millimetre; the simulator as given expects to predict what nobody can.
    """
    state, rules = renoised(state, best, criteria), criteria.rules
    best = state.tried[best.key]
    # It leaves less than before: each nat counts for more, and along a ridge, such as that of a
    # dead time and a clock, there is a way to go.
    state = state.dispersed(rules.expected_left * best.typical)
    start = local_restart(state.problem, best.fit, rules.restarts)
    state, results = tried_too(state, [best.fit, start], criteria)
    return state, results[-1]


def renoised(state: State, best: Candidate, criteria: Criteria) -> State:
    """All hypotheses under the noise model linearised about the best one."""
    problem = state.problem
    settings = problem.library.settings([(best.fit, best.fit.vector)])
    noise = noise_model(problem.simulation, problem.segments, settings, extra=problem.noise.extra)
    change = noise.change_from(problem.noise)
    problem = replace(problem, noise=noise)
    fits = []
    for candidate in state.tried.values():
        fit, jacobian = candidate.fit, candidate.fit.jacobian
        whitened = torch.einsum("nij,nj->ni", change, fit.whitened)
        jacobian = None if jacobian is None else change @ jacobian
        fits.append(replace(fit, whitened=whitened, jacobian=jacobian))
    known = cross_validated(problem, fits, criteria.group)
    candidates = [Candidate(fit, cv) for fit, cv in zip(fits, known, strict=True)]
    return State(problem, dict(zip(state.tried, candidates, strict=True)))


def local_restart(problem: Problem, fit: Fit, offsets: Sequence[float]) -> Fit:
    """The best vector nearby that a derivative does not show.

    Half a sample of clock and half of a dead time are smoother than a whole one, and a throttle
    within the motor's deadband does nothing: fits rest in valleys and on steps.
    """
    return restarted(problem, fit, problem.rolled_out(restarts(fit, offsets)))


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


def warm_started(
    state: State, base: Candidate, criteria: Criteria
) -> tuple[State, Candidate | None]:
    """The base, fitted on from where its effects came to beside others; None if no better.

    A fit may be stuck where one with a parameter more, however small that is, found a way on.
    """
    problem, least = state.problem, criteria.rules.min_nats
    vectors = []
    for candidate in state.tried.values():
        if set(candidate.effects) > set(base.effects) > set():
            beside = problem.library.at(base.effects, candidate.fit.named())
            vectors.append(beside.vector)
    found = min(_at(problem, base.fit, vectors), key=problem.cost, default=base.fit)
    if problem.cost(base.fit) - problem.cost(found) < least:
        return state, None
    before = state.loss(base)
    state, [better] = tried_too(state, [found], criteria)
    return state, better if before - state.loss(better) > least else None


def _at(problem: Problem, fit: Fit, vectors: Sequence[Tensor]) -> list[Fit]:
    """The same effects at other vectors [P], within their bounds, rolled out."""
    return problem.rolled_out([fit.at(vector) for vector in vectors])
