"""What a cause must do on what it was not fitted to, to be named."""

from collections.abc import Collection
from dataclasses import dataclass

import torch
from torch import Tensor

from buggy_rl.diagnosis.candidate import Candidate, size
from buggy_rl.estimation.cross_validation import advantage
from buggy_rl.estimation.gauss_newton import Fitted, Fitter
from buggy_rl.estimation.misfit import Usual

NATS = 6.0  # by which it must help at least, for each of its parameters
LOST = 0.3  # of the nats won in some blocks that may be lost in others
FAINT = 0.1  # of its typical size: what is smaller is no cause
MATTERS = 0.01  # of the noise: what closes less of the gap does not matter,
SHARE = 0.05  # nor what closes less of the gap that there was at first,
TYPICAL = 0.5  # size above which a further cause need close less of it, by the size's square,
LIGHT = 0.1  # down to this part;
TWINS = 0.1  # and as much more if it does the same as the others: see `Merit.likeness`
UNASKED = 0.5  # and half of it, where the simulator is as right as it ever was: nobody asked,
ENOUGH = 0.15  # or a quarter, if that is more than this: twice what any cause closed of 66 cars
# with nothing wrong
LIKEWISE = 0.2  # of what a cause wins, that it may win on drives from before the change


@dataclass(frozen=True)
class Merit:
    """By what causes are judged.

    Args:
        fitter: Fits to all stretches.
        group: [N] Blocks of stretches that are held out together.
        usual: Excess of drives on which the simulator counts as right.
        baseline: Fits to stretches of those.
    """

    fitter: Fitter
    group: Tensor
    usual: Usual
    baseline: Fitter | None = None

    def helps(self, more: Candidate, less: Candidate, null: Candidate) -> bool:
        """Whether causes earn their place on what they were not fitted to.

        They must help by enough nats, whichever block of the drives is left out; lose little where
        they do not help; and close a part of the gap that was there at first that matters.
        """
        gain = advantage(
            self.fitter.likelihood,
            max(1.0, more.typical),
            more.evidence,
            less.evidence,
            self.group,
        )
        added = len(more.fitted.unknowns) - len(less.fitted.unknowns)
        large = self.largest(more.fitted, less.causes)
        least = self.least(
            size(null, null),
            self.likeness(more.fitted, set(less.causes)),
            large if less.causes else 0.0,
        )
        return (
            large > FAINT
            and gain.without_best > NATS * added
            and gain.lost < LOST * gain.won
            and size(less, null) - size(more, null) > least
            and not self.stands(more, less)
        )

    def largest(self, fitted: Fitted, others: Collection[str]) -> float:
        """How large the further causes of an explanation are, in units of their typical sizes."""
        numbers = zip(fitted.unknowns, fitted.place.tolist(), strict=True)
        further = ((u, abs(z)) for u, z in numbers if u.cause and u.cause not in others)
        deciding = self.fitter.library.deciding
        return max((z for u, z in further if u.parameter.name in deciding(u.cause)), default=0.0)

    def least(self, gap: float, likeness: float = 0.0, large: float = 0.0) -> float:
        """What a cause must close at least, as an excess over the noise.

        What does much the same as the other causes must close more: an equation that is nearly
        right leaves a gap that resembles what it describes, and a lag that is not quite of first
        order is not a lag and a dead time. What is as large as faults of its kind are need close
        less: small numbers make up for what an equation that is nearly right leaves. Where the
        simulator is as right as on its baseline, half of what gap there is, or a quarter that is
        more than what any cause closes of nothing.

        Args:
            gap: Excess of the simulator as given.
            likeness: See there.
            large: See `largest`.
        """
        share = SHARE * max(LIGHT, min(1.0, (TYPICAL / max(large, FAINT)) ** 2))
        least = max(MATTERS, self.usual.error, (share + TWINS * likeness) * gap)
        if gap < self.usual.most:
            least = max(least, min(UNASKED * gap, max(ENOUGH, UNASKED / 2 * gap)))
        return least

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
