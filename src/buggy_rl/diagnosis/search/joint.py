"""Joint search: sets of effects proposed together by linear algebra, fitted, and looked at anew.

1. Fit the simulator as given; roll out every effect at its trial sizes, all in one batch.
2. Propose sets by the superposition of their secants; fit and cross-validate the best of each size.
3. Re-linearise noise and secants about the leading set; propose what adds, removes or swaps effects
   of it; fit. Until the leading set stays.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import torch

from buggy_rl.diagnosis.run.budget import FULL, Budget
from buggy_rl.diagnosis.run.case import Criteria
from buggy_rl.diagnosis.run.plan import Part
from buggy_rl.diagnosis.search.candidate import Candidate, Effects, conditions, priced
from buggy_rl.diagnosis.search.changed import Changed, Usual, usual
from buggy_rl.diagnosis.search.limits import missing_hypotheses
from buggy_rl.diagnosis.search.posterior import Posterior
from buggy_rl.diagnosis.search.result import (
    Progress,
    SearchResult,
    State,
    renoised,
    restarted,
    restarts,
    tried_too,
)
from buggy_rl.diagnosis.search.ways import unit_changes
from buggy_rl.estimation.evidence import Evidence, evidence
from buggy_rl.estimation.gauss_newton import Fit, Problem
from buggy_rl.estimation.hypothesis import Hypothesis
from buggy_rl.estimation.noise_model import NoiseModel
from buggy_rl.estimation.sparse import Proposal, Secants, proposals, thinned, trials

LOOKED_AT = 24  # segments, spread evenly, on which sets about the leading one are proposed
MOST = 4  # effects of a set
Keep = Callable[[str, Callable[[], Any]], Any]
"""A name and how its result is computed -> the result."""
Admits = Callable[[Part], bool]
"""A part of the search -> whether there is time for it."""


@dataclass(frozen=True, eq=False)
class Weighed:
    """A fitted hypothesis and its evidence."""

    candidate: Candidate
    evidence: Evidence
    asked: bool = False
    """Fitted since it was asked for, and for nothing else."""
    changed: float = 0.0
    """Log evidence [nats] beside what simulator and car differ in anyway, less the best set's."""


@dataclass(frozen=True, eq=False)
class JointSearch:
    """What a joint search came to."""

    problem: Problem
    null: Candidate
    """The simulator as given, with its clock fitted."""
    weighed: list[Weighed]
    """The most evident first; the simulator as given among them."""
    proposed: list[Proposal]
    """All sets, by the loss of their superposition about the simulator as given."""
    left_out: tuple[str, ...] = ()
    """Parts for which there was no time, in words."""

    def result(
        self, posterior: Posterior, varying: Callable[[Effects], Mapping[str, str]]
    ) -> SearchResult:
        """Result with the most probable answer as the best; nothing, where that is most probable.

        Args:
            posterior: Of what was fitted.
            varying: Of a set: effect -> condition with which its numbers vary.
        """
        tried = {w.candidate.key: w.candidate for w in self.weighed}
        best = tried[() if posterior.says == "nothing" else posterior.best]
        return SearchResult(
            best,
            tried,
            self.problem.noise,
            max(1.0, best.typical),
            posterior,
            {w.candidate.key: w.evidence.log_evidence for w in self.weighed},
            varying(best.key),
            left_out=self.left_out,
        )

    def rank(self, effects: Effects) -> int:
        """Place of a set among the proposed ones of its size, from 1; 0 where it is not."""
        same = [p.key for p in self.proposed if len(p.key) == len(effects)]
        return same.index(effects) + 1 if effects in same else 0


def joint_search(
    problem: Problem,
    criteria: Criteria,
    also: Sequence[Effects] = (),
    progress: Progress = lambda _: None,
    budget: Budget = FULL,
    kept: Keep = lambda _, compute: compute(),
    admits: Admits = lambda _: True,
) -> JointSearch:
    """Finds sets of effects by the superposition of their secants, fits and weighs the best.

    Args:
        problem: Simulator and segments.
        criteria: Blocks and iterations.
        also: Sets that are fitted whether they are promising or not.
        progress: Told what is being done.
        budget: How much is rolled out.
        kept: Gives the result of a part, computed or as it was kept before an interruption.
        admits: Whether there is time for a round, or for fitting on at the end.
    """
    rules = criteria.rules
    rules = replace(rules, iterations=min(budget.iterations, rules.iterations))
    criteria = replace(criteria, rules=rules, anew=budget.anew)
    begun = kept("begun", lambda: _begun(problem, criteria, also, progress, budget))
    proposed = begun.proposed
    left_out: list[str] = []
    first = begun.fitted.state(problem)
    state = _settled(first, criteria, progress, budget, kept, admits, left_out)
    found = set(state.tried)
    asked = [p for p in proposed if p.key in map(_sorted, also) and p.key not in found]
    state, _ = tried_too(state, [p.start for p in asked], criteria)
    promising = {c.key: c for c in _ranked(state)}
    state, _ = tried_too(
        state, missing_hypotheses(promising, problem.segments, problem.library), criteria
    )
    progress(f"weighing {len(state.tried)} hypotheses")
    weighed = _weighed(state, begun, problem, found, criteria)
    return JointSearch(state.problem, state.null, weighed, proposed, tuple(left_out))


@dataclass(frozen=True, eq=False)
class _Tried:
    """What a state has beyond its problem, which cannot be written to a file."""

    tried: Mapping[Effects, Candidate]
    noise: NoiseModel
    dispersion: float

    @classmethod
    def of(cls, state: State) -> "_Tried":
        return cls(state.tried, state.problem.noise, state.problem.dispersion)

    def state(self, problem: Problem) -> State:
        return State(replace(problem, noise=self.noise, dispersion=self.dispersion), self.tried)


@dataclass(frozen=True, eq=False)
class _Begun:
    """What a search is before it looks about the leading set."""

    null: Candidate
    rolled: list[Fit]
    proposed: list[Proposal]
    fitted: _Tried
    usual: Usual | None
    """What the simulator lacks of every effect on its baseline; None without one."""


def _begun(
    problem: Problem,
    criteria: Criteria,
    also: Sequence[Effects],
    progress: Progress,
    budget: Budget,
) -> _Begun:
    """Rolls out every effect, and fits what their superposition proposes."""
    state, [null] = tried_too(State(problem, {}), [problem.library.hypothesis(())], criteria)
    state = state.dispersed(criteria.rules.expected_left * null.typical)
    progress(f"rolling out {len(problem.library.names)} effects")
    rolled = state.problem.rolled_out(trials(state.problem, null.fit, budget.sizes))
    first = Secants.of(state.problem, null.fit, rolled)
    proposed = proposals(
        first, max(size for size, most in budget.fitted.items() if most), also=also
    )
    starts = [
        p.start for size, most in budget.fitted.items() for p in _of_size(proposed, size)[:most]
    ]
    before = criteria.baseline
    known = None if before is None else usual(before)
    secants = unit_changes(null.fit, rolled)
    since = Changed.since(known, state.problem, criteria.group, null.fit, secants)
    taken = {_sorted(start.effects) for start in starts}
    more = since.proposed(null.fit, rolled, budget.fitted)
    starts += [start for start in more if _sorted(start.effects) not in taken]
    progress(f"fitting {len(starts)} hypotheses")
    state, _ = tried_too(state, starts, criteria, null)
    return _Begun(null, rolled, proposed, _Tried.of(state), known)


def _settled(
    state: State,
    criteria: Criteria,
    progress: Progress,
    budget: Budget,
    kept: Keep,
    admits: Admits,
    left_out: list[str],
) -> State:
    """Looks about the leading set until it stays, or so many rounds, or until time is up.

    What there is no time for is added to `left_out`.
    """
    seen: set[Effects] = set()
    for number in range(budget.rounds):
        best = state.leading
        if best.key in seen:
            break
        seen.add(best.key)
        if not admits("round" if number else "first_round"):
            left_out.append(f"{budget.rounds - number} of at most {budget.rounds} rounds")
            break
        progress(f"looking about {'+'.join(best.key) or 'the simulator as given'}")
        now = kept(f"round_{number}", partial(_round, state, best, criteria, budget))
        state = now.state(state.problem)
    if not budget.refitted:
        return state
    if not admits("refitted"):
        left_out.append(f"fitting {budget.refitted} sets on at the end")
        return state
    last = kept("refitted", lambda: _Tried.of(_refitted(state, criteria, budget.refitted)))
    return last.state(state.problem)


def _refitted(state: State, criteria: Criteria, count: int) -> State:
    """The most promising hypotheses fitted on, under the noise and dispersion of the end.

    Those of the first round were fitted while much was left, and stopped where it did not matter.
    """
    state = state.dispersed(state.leading.typical)
    return tried_too(state, [c.fit for c in _ranked(state)[:count]], criteria)[0]


def _ranked(state: State) -> list[Candidate]:
    """What was fitted, the most promising first."""
    return sorted(state.tried.values(), key=lambda c: priced(c, state.loss(c)))


def _round(state: State, best: Candidate, criteria: Criteria, budget: Budget) -> _Tried:
    return _Tried.of(_about(renoised(state, best, criteria), best.key, criteria, budget))


def _about(state: State, key: Effects, criteria: Criteria, budget: Budget) -> State:
    """Fits a set further, what is left of it without each of its effects, and sets near it.

    Few batches: a rollout of few environments takes as long as one of many.
    """
    state = state.dispersed(criteria.rules.expected_left * state.tried[key].typical)
    problem, base = state.problem, state.tried[key].fit
    shaken = restarts(base, criteria.rules.restarts)
    less = [
        problem.library.at([e for e in base.effects if e != out], base.named())
        for out in base.effects
    ]
    rolled = problem.rolled_out([*shaken, *less])
    shifted, without = rolled[: len(shaken)], rolled[len(shaken) :]
    secants = _secants(problem, base, without, budget.sizes)
    near = proposals(secants, MOST, added=2, removed=min(2, len(less)))
    starts: list[Hypothesis] = [base, restarted(problem, base, shifted)]
    starts += less  # also what was tried before: better numbers are known now
    known = {*state.tried, *(tuple(sorted(h.effects)) for h in starts)}
    for size in range(1, MOST + 1):
        new = [p.start for p in _of_size(near, size) if p.key not in known]
        starts += new[: budget.around if abs(size - len(less)) < 2 else 1]
    return tried_too(state, starts, criteria)[0]


def _secants(
    problem: Problem, base: Fit, removals: Sequence[Fit], sizes: Sequence[float]
) -> Secants:
    """Secants about a base, on some of the segments: they only propose what is fitted to all."""
    few, [at, *less] = thinned(problem, LOOKED_AT, [base, *removals])
    return Secants.of(few, at, few.rolled_out(trials(problem, base, sizes)), less)


def _weighed(
    state: State, begun: _Begun, problem: Problem, found: set[Effects], criteria: Criteria
) -> list[Weighed]:
    """The evidence of all that was fitted, under the noise model that the search came to."""
    change = state.problem.noise.change_from(problem.noise)
    null, *rolled = (fit.rewhitened(change) for fit in (begun.null.fit, *begun.rolled))
    ways, changes = unit_changes(null, rolled)
    instants = problem.simulation.instants(problem.segments)
    driven = torch.stack(list(conditions(problem.segments, instants).values()), -1)
    every = [*state.tried.values()]
    since = Changed.since(begun.usual, state.problem, criteria.group, null, (ways, changes))
    changed = since.log_evidence([candidate.fit for candidate in every])
    weighed = []
    for candidate, nats in zip(every, changed, strict=True):
        others = [i for i, (name, _) in enumerate(ways) if name not in candidate.effects]
        own = evidence(candidate.fit, changes[..., others], driven)
        weighed.append(Weighed(candidate, own, candidate.key not in found, nats))
    return sorted(weighed, key=lambda w: -w.evidence.log_evidence)


def _sorted(effects: Effects) -> Effects:
    return tuple(sorted(effects))


def _of_size(proposed: Sequence[Proposal], size: int) -> list[Proposal]:
    return [p for p in proposed if len(p.key) == size]
