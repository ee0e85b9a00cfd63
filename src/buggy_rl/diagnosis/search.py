"""Which effects explain the drives: rivals screened, fitted, compared, combined, eliminated."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from buggy_rl.diagnosis.candidate import Candidate, in_its_place, size
from buggy_rl.diagnosis.selection import NATS, Merit
from buggy_rl.diagnosis.swap import exchanges
from buggy_rl.estimation.cross_validation import blocks, evidences
from buggy_rl.estimation.gauss_newton import Fitted, Fitter
from buggy_rl.estimation.hypothesis import bounded
from buggy_rl.estimation.misfit import Usual
from buggy_rl.estimation.noise_model import likelihood
from buggy_rl.estimation.screening import screened

ITERATIONS = 6  # of a fit
POLISHED = 8  # times that the best is fitted on at most
SHAKEN = (-0.3, -0.1, -0.03, 0.03, 0.1, 0.3)  # of a size: how far around it is looked once more
KEPT = 12  # effects that are fitted after the screening
EXTENDED = 6  # effects that are fitted beside those already found
MOST = 4  # effects of one explanation
EAGER = 0.25  # share of what is left over that the next effect is not expected to explain


@dataclass
class Found:
    """What the search came to."""

    null: Candidate
    best: Candidate
    tried: dict[tuple[str, ...], Candidate] = field(default_factory=dict)
    """All explanations by their causes, sorted."""
    temper: float = 1.0
    """How much worse than noise the best is."""
    plays: int = 0
    """How often all stretches were rolled out on the way."""

    def without(self, cause: str) -> float:
        """Excess over the noise without a cause, on what was held out."""
        key = tuple(sorted(set(self.best.causes) - {cause}))
        return size(self.tried.get(key, self.null), self.null)

    def closed(self, cause: str) -> float:
        """Excess that comes back without a cause, on what was held out; not below 0."""
        return max(0.0, self.without(cause) - size(self.best, self.null))


class Search:
    """Forward selection with backward elimination.

    Args:
        fitter: Fits to all stretches.
        progress: Told in plain words what is being done.
        baseline: To stretches on which the simulator counts as right.
        usual: Excess of drives on which the simulator counts as right.
    """

    def __init__(
        self,
        fitter: Fitter,
        progress: Callable[[str], None] = lambda _: None,
        baseline: Fitter | None = None,
        usual: Usual | None = None,
    ) -> None:
        self.fitter, self.progress = fitter, progress
        self.group = blocks(fitter.cut)
        self.merit = Merit(fitter, self.group, usual or Usual(), baseline)
        self.tried: dict[tuple[str, ...], Candidate] = {}

    @classmethod
    def after(cls, fitter: Fitter, found: Found) -> "Search":
        """One that has come to what was found."""
        search = cls(fitter)
        search.null, search.tried, fitter.temper = found.null, found.tried, found.temper
        fitter.plays = found.plays
        return search

    def run(self) -> Found:
        """Finds the best explanation and all rivals that came close."""
        self.null = best = self.fit([self.fitter.start(())])[0]
        while len(best.causes) < MOST:
            # What the best so far leaves is no noise: so much less does a nat count.
            self.fitter.temper = max(1.0, EAGER * best.typical)
            step = self.extended(best)
            step = self.taught(best) if step is None else self.eliminated(step)
            if step is None:
                break
            best = self.reweighed(step)
        weighty = self.weighty(best)
        if weighty is not best:  # it was fitted on the way, and not to the end
            best = self.reweighed(weighty)
        exchanged = self.exchanged(best)
        if exchanged is not best:
            best = self.reweighed(self.weighty(exchanged))
        self.fitter.temper = max(1.0, best.typical)
        return Found(self.null, best, self.tried, self.fitter.temper, self.fitter.plays)

    def loss(self, candidate: Candidate) -> float:
        """On what was held out, with its priors [nats]."""
        losses = self.fitter.likelihood.loss(candidate.evidence.square, self.fitter.temper)
        return float(losses.sum() + candidate.fitted.penalty())

    def reweighed(self, best: Candidate) -> Candidate:
        """Weighs all explanations anew by how errors of a start grow in the best of them.

        On a slippery floor a car spins, or not, by a millimetre: the simulator as given, which
        does not know of the floor, expects to foretell what nobody can.
        """
        fitter, old = self.fitter, self.fitter.likelihood
        settings = fitter.library.settings([(best.fitted.unknowns, best.fitted.place)])
        fitter.likelihood = likelihood(fitter.player, fitter.cut, settings, old.extra)
        change = fitter.likelihood.instead_of(old)
        for candidate in self.tried.values():
            fitted = candidate.fitted
            fitted.white = torch.einsum("nij,nj->ni", change, fitted.white)
            if fitted.slopes is not None:
                fitted.slopes = change @ fitted.slopes
        tried = list(self.tried.values())
        anew = evidences(fitter, [candidate.fitted for candidate in tried], self.group)
        for candidate, known in zip(tried, anew, strict=True):
            candidate.evidence = known
        for _ in range(POLISHED):
            # What it leaves is nearer to noise than what was there before: each nat counts for
            # more, and along a ridge, such as a dead time's and a clock's, there is a way to go.
            fitter.temper = max(1.0, EAGER * best.typical)
            before = self.loss(best)
            best = self.fit([best.fitted, *self.shaken(best.fitted)])[-1]
            if before - self.loss(best) < NATS:
                break
        return best

    def shaken(self, fitted: Fitted) -> list[Fitted]:
        """The best place nearby that a slope does not show, if there is one.

        Half a sample of clock and half of a dead time are smoother than a whole one, and a
        throttle that is in part within the motor's deadband does nothing: fits come to rest in
        valleys and on steps that are not the end of the way.
        """
        places = [fitted.place.clone()]
        places[0][-1] = 0.0  # a right clock
        for index in range(len(fitted.place) - 1):
            for far in SHAKEN:
                places.append(fitted.place.clone())
                places[-1][index] += far
        trials = self._placed(fitted, places)
        found = min(trials, key=self.fitter.value)
        better = self.fitter.value(found) < self.fitter.value(fitted)
        return [found] if better else [trials[0]]

    def taught(self, base: Candidate) -> Candidate | None:
        """The base, fitted on from where the same causes came to beside another; None if no better.

        A fit may be stuck where one with a number more, however little that is, found a way on.
        """
        places = []
        for candidate in self.tried.values():
            if set(candidate.causes) > set(base.causes) > set():
                numbers = zip(candidate.fitted.unknowns, candidate.fitted.place, strict=True)
                there = {(u.cause, u.parameter.name): float(z) for u, z in numbers}
                place = [there[u.cause, u.parameter.name] for u in base.fitted.unknowns]
                places.append(torch.tensor(place, dtype=torch.float64))
        trials = self._placed(base.fitted, places)
        found = min(trials, key=self.fitter.value, default=base.fitted)
        if self.fitter.value(base.fitted) - self.fitter.value(found) < NATS:
            return None
        before = self.loss(base)
        better = self.fit([found])[0]
        return better if before - self.loss(better) > NATS else None

    def _placed(self, fitted: Fitted, places: Sequence[Tensor]) -> list[Fitted]:
        """The same causes with other numbers [P], within their bounds, rolled out."""
        rows = [(fitted, bounded(fitted.unknowns, place)) for place in places]
        return [
            Fitted(fitted.causes, fitted.unknowns, place, white)
            for (_, place), white in zip(rows, self.fitter.evaluate(rows), strict=True)
        ]

    def fit(self, starts: Sequence[Fitted], base: Candidate | None = None) -> list[Candidate]:
        """Fits and weighs explanations; the better one of two with the same effects is kept.

        Args:
            starts: Where each begins.
            base: What they are to be better than, where only the better ones matter.
        """
        if not starts:
            return []
        results = []
        worst = None if base is None else self.fitter.value(base.fitted)
        found = self.fitter.fit(starts, ITERATIONS, worst)
        for fitted, known in zip(found, evidences(self.fitter, found, self.group), strict=True):
            candidate = Candidate(fitted, known)
            key = tuple(sorted(fitted.causes))
            before = self.tried.get(key)
            if before is None or self.loss(candidate) < self.loss(before):
                self.tried[key] = candidate
            results.append(self.tried[key])
        return results

    def extended(self, base: Candidate) -> Candidate | None:
        """The base with the effect that helps most; None when none helps enough."""
        self.progress(f"screening {len(self.fitter.library.causes)} effects")
        starts = screened(self.fitter, base.fitted, KEPT if not base.causes else EXTENDED)
        self.progress(f"fitting {len(starts)} explanations")
        fitted = self.fit(starts, base)
        helping = [c for c in fitted if self.merit.helps(c, base, self.null)]
        return min(helping, key=self.loss, default=None)

    def eliminated(self, candidate: Candidate) -> Candidate:
        """Leaves out effects that are not needed any more."""
        while len(candidate.causes) > 1:
            needless = [
                less
                for less in self.without_one(candidate)
                if not self.merit.helps(candidate, less, self.null)
            ]
            if not needless:
                return candidate
            candidate = min(needless, key=self.loss)
        return candidate

    def weighty(self, candidate: Candidate) -> Candidate:
        """Leaves out further effects that close less than what remains, the least first.

        What no equation closes resembles many of them a little: a cause that is smaller than that
        is as likely a part of it as a cause.
        """
        while len(candidate.causes) > 1:
            rest = size(candidate, self.null) - self.merit.usual.mean
            less = min(self.without_one(candidate), key=lambda c: size(c, self.null))
            if size(less, self.null) - size(candidate, self.null) > max(rest, 0.0):
                return candidate
            candidate = less
        return candidate

    def exchanged(self, best: Candidate) -> Candidate:
        """The best, or what is better with a rival in the place of one of its several causes.

        All of its causes must earn their place: one that mends the baseline likewise does not.
        """
        if len(best.causes) < 2:
            return best
        self.fit(exchanges(self.fitter, best, self.tried, self.null))
        beside = (in_its_place(self.tried, frozenset(best.causes) - {c}) for c in best.causes)
        others = [c for rivals in beside for rival, c in rivals.items() if rival]
        other = min(others, key=self.loss)
        better = self.loss(best) - self.loss(other) > NATS
        return other if better and self.eliminated(other) is other else best

    def without_one(self, candidate: Candidate) -> list[Candidate]:
        """The same without each of its effects, fitted."""
        starts, fitted = [], []
        for left_out in candidate.causes:
            keep = tuple(e for e in candidate.causes if e != left_out)
            known = self.tried.get(tuple(sorted(keep)))
            if known is not None:  # the way here led over it
                fitted.append(known)
                continue
            numbers = zip(candidate.fitted.unknowns, candidate.fitted.place.tolist(), strict=True)
            places = [z for u, z in numbers if u.cause != left_out]
            starts.append(self.fitter.start(keep, places))
        return fitted + self.fit(starts)
