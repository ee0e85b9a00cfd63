"""Which effects explain the drives: rivals screened, fitted, compared, combined, eliminated."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from buggy_rl.diagnosis.adequacy import Usual, misfit, typical
from buggy_rl.diagnosis.evidence import Evidence, advantage, blocks, evidence
from buggy_rl.diagnosis.fit import Fitted, Fitter
from buggy_rl.diagnosis.library import bounded
from buggy_rl.diagnosis.likelihood import likelihood
from buggy_rl.diagnosis.screening import screened

ITERATIONS = 6  # of a fit
POLISHED = 3  # times that the best is fitted on at most
SHAKEN = (-0.3, -0.1, -0.03, 0.03, 0.1, 0.3)  # of a size: how far around it is looked once more
KEPT = 12  # effects that are fitted after the screening
EXTENDED = 6  # effects that are fitted beside those already found
MOST = 4  # effects of one explanation
LOST = 0.3  # of the nats won in some blocks that may be lost in others
NATS = 6.0  # by which it must help at least, for each of its parameters
EAGER = 0.25  # share of what is left over that the next effect is not expected to explain
MATTERS = 0.01  # of the noise: what closes less of the gap does not matter,
SHARE = 0.05  # nor what closes less of the gap that there was at first,
FAINT = 0.1  # of its typical size: what is smaller is no cause
UNASKED = 0.5  # and half of it, where the simulator is as right as it ever was: nobody asked,
LIKEWISE = 0.2  # of what a cause wins, that it may win on drives from before the change
TWINS = 0.2  # and as much more if it does the same as the others: see `Search.helps`


@dataclass
class Candidate:
    """An explanation, fitted, with what speaks for it."""

    fitted: Fitted
    evidence: Evidence

    @property
    def causes(self) -> tuple[str, ...]:
        """What it explains the drives by."""
        return self.fitted.causes

    @property
    def held_out(self) -> Tensor:
        """[N] mean square of each stretch when its block was held out, over noise."""
        return self.evidence.square / self.fitted.white.shape[-1]

    @property
    def typical(self) -> float:
        """What is usual among them."""
        return typical(self.held_out)


@dataclass
class Found:
    """What the search came to."""

    null: Candidate
    best: Candidate
    tried: dict[tuple[str, ...], Candidate] = field(default_factory=dict)
    """All explanations by their causes, sorted."""
    temper: float = 1.0
    """How much worse than noise the best is."""


class Search:
    """Forward selection with backward elimination and swaps.

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
        self.fitter, self.progress, self.baseline = fitter, progress, baseline
        self.usual = usual or Usual()
        self.group = blocks(fitter.cut)
        self.tried: dict[tuple[str, ...], Candidate] = {}

    @classmethod
    def after(cls, fitter: Fitter, found: Found) -> "Search":
        """One that has come to what was found."""
        search = cls(fitter)
        search.null, search.tried, fitter.temper = found.null, found.tried, found.temper
        return search

    def run(self) -> Found:
        """Finds the best explanation and all rivals that came close."""
        self.null = best = self.fit([self.fitter.start(())])[0]
        while len(best.causes) < MOST:
            # What the best so far leaves is no noise: so much less does a nat count.
            self.fitter.temper = max(1.0, EAGER * best.typical)
            step = self.extended(best)
            if step is None:
                break
            best = self.reweighed(self.eliminated(step))
        self.fitter.temper = max(1.0, best.typical)
        return Found(self.null, best, self.tried, self.fitter.temper)

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
            candidate.evidence = evidence(fitter, fitted, self.group)
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
        rows = [(fitted, bounded(fitted.unknowns, place)) for place in places]
        trials = [
            Fitted(fitted.causes, fitted.unknowns, place, white)
            for (_, place), white in zip(rows, self.fitter.evaluate(rows), strict=True)
        ]
        found = min(trials, key=self.fitter.value)
        better = self.fitter.value(found) < self.fitter.value(fitted)
        return [found] if better else [trials[0]]

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
        for fitted in self.fitter.fit(starts, ITERATIONS, worst):
            candidate = Candidate(fitted, evidence(self.fitter, fitted, self.group))
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
        helping = [c for c in fitted if self.helps(c, base)]
        return min(helping, key=self.loss, default=None)

    def helps(self, more: Candidate, less: Candidate) -> bool:
        """Whether causes earn their place on what they were not fitted to.

        They must help by enough nats, whichever block of the drives is left out; lose little where
        they do not help; and close a part of the gap that was there at first that matters. What
        does much the same as the other causes must close more of it: an equation that is nearly
        right leaves a gap that resembles what it describes, and a lag that is not quite of first
        order is not a lag and a dead time. Where the simulator is as right as on its baseline, half
        of what gap there is.
        """
        gain = advantage(
            self.fitter.likelihood,
            max(1.0, more.typical),
            more.evidence,
            less.evidence,
            self.group,
        )
        added = len(more.fitted.unknowns) - len(less.fitted.unknowns)
        share = SHARE + TWINS * self.likeness(more.fitted, set(less.causes))
        if size(self.null) < self.usual.most:
            share = max(share, UNASKED)
        coordinates = [
            abs(z)
            for u, z in zip(more.fitted.unknowns, more.fitted.place.tolist(), strict=True)
            if u.cause and u.cause not in less.causes
        ]
        return (
            max(coordinates, default=0.0) > FAINT
            and gain.without_best > NATS * added
            and gain.lost < LOST * gain.won
            and any(
                measure(less) - measure(more)
                > max(MATTERS, self.usual.error, share * measure(self.null))
                for measure in (size, _usual_size)
            )
            and not self.stands(more, less)
        )

    def stands(self, more: Candidate, less: Candidate) -> bool:
        """Whether causes mend the baseline likewise: then they are nothing that has changed.

        There they are looked at alone: whatever else was found has not happened yet.
        """
        if self.baseline is None:
            return False
        fitted = more.fitted
        kept = {
            (u.cause, u.parameter.name): float(z)
            for u, z in zip(fitted.unknowns, fitted.place, strict=True)
            if u.cause and u.cause not in less.causes
        }
        alone = self.baseline.start(tuple(c for c in more.causes if c not in less.causes))
        place = [kept.get((u.cause, u.parameter.name), 0.0) for u in alone.unknowns]
        loss = self.baseline.likelihood.loss
        rows = [(alone, torch.zeros_like(alone.place)), (alone, torch.tensor(place).double())]
        before, after = (w.square().sum(-1) for w in self.baseline.evaluate(rows))
        there = float((loss(before) - loss(after)).mean())
        loss = self.fitter.likelihood.loss
        here = float((loss(less.evidence.square) - loss(more.evidence.square)).mean())
        return there > LIKEWISE * here

    def likeness(self, fitted: Fitted, others: Collection[str]) -> float:
        """Share of what the further causes of an explanation do that `others` of it do likewise.

        R^2 of the whitened gaps that they close, to first order, over those that each other cause
        closes.
        """
        assert fitted.slopes is not None
        root = self.fitter.likelihood.weight(fitted.square, self.fitter.temper).sqrt()
        done = fitted.slopes * fitted.place * root[:, None, None]  # (N, D, P)
        parts: dict[str, Tensor] = {}
        for index, unknown in enumerate(fitted.unknowns):
            if unknown.cause:
                name = unknown.cause if unknown.cause in others else ""
                part = done[..., index].flatten()
                parts[name] = parts[name] + part if name in parts else part
        added = parts.pop("", None)
        if added is None or not parts:
            return 0.0
        columns = torch.stack(list(parts.values()), -1)
        share = torch.linalg.lstsq(columns, added.unsqueeze(-1), driver="gelsd").solution
        explained = (columns @ share).square().sum() / added.square().sum().clamp_min(1e-12)
        return float(explained.clamp(0.0, 1.0))

    def eliminated(self, candidate: Candidate) -> Candidate:
        """Leaves out effects that are not needed any more."""
        while len(candidate.causes) > 1:
            starts, fitted = [], []
            for left_out in candidate.causes:
                keep = tuple(e for e in candidate.causes if e != left_out)
                known = self.tried.get(tuple(sorted(keep)))
                if known is not None:  # the way here led over it
                    fitted.append(known)
                    continue
                places = [
                    z
                    for u, z in zip(
                        candidate.fitted.unknowns, candidate.fitted.place.tolist(), strict=True
                    )
                    if u.cause != left_out
                ]
                starts.append(self.fitter.start(keep, places))
            fitted += self.fit(starts)
            needless = [c for c in fitted if not self.helps(candidate, c)]
            if not needless:
                return candidate
            candidate = min(needless, key=self.loss)
        return candidate


def size(candidate: Candidate) -> float:
    """Excess of gaps on what was held out, over the noise's."""
    return misfit(candidate.held_out) - 1


def _usual_size(candidate: Candidate) -> float:
    """Likewise, where most stretches are so far off that the mean is at its cap."""
    return candidate.typical**0.5 - 1
