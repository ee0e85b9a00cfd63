"""Fits many rival explanations to drives at once: every column and trial a row of one batch."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from buggy_rl.estimation.hypothesis import Library, Unknown, bounded
from buggy_rl.estimation.noise_model import Likelihood
from buggy_rl.estimation.rollout import Player
from buggy_rl.estimation.segments import Stretches

STEP = 0.02  # of a finite difference, in units of a parameter's size
TRIED = 2  # iterations after which it shows who is hopeless:
HOPELESS = 0.3  # who has not gained this share of what the best has gained
AT = 1e-6  # of its size: what is no further from an end of its range lies at it
DAMPINGS = (1e-6, 0.1, 10.0)  # the first goes all the way along a ridge


@dataclass
class Fitted:
    """An explanation fitted to stretches."""

    causes: tuple[str, ...]
    unknowns: tuple[Unknown, ...]
    place: Tensor
    """[P] coordinates: distance from neutral in units of size."""
    white: Tensor
    """[N, D] whitened gaps."""
    slopes: Tensor | None = None
    """[N, D, P] their derivatives."""

    @property
    def square(self) -> Tensor:
        """[N] |W e|^2 of each stretch."""
        return self.white.square().sum(-1)

    def penalty(self, place: Tensor | None = None) -> Tensor:
        """Of the priors, in nats."""
        place = self.place if place is None else place
        prior = torch.tensor([u.prior for u in self.unknowns], dtype=torch.float64)
        return 0.5 * (place / prior).square().sum(-1)

    def values(self) -> dict[str, dict[str, float]]:
        """Cause -> parameter -> value; the clock under the name of no cause."""
        result: dict[str, dict[str, float]] = {}
        for unknown, z in zip(self.unknowns, self.place.tolist(), strict=True):
            result.setdefault(unknown.cause, {})[unknown.parameter.name] = float(
                unknown.parameter.value_at(z)
            )
        return result

    def at_bound(self, cause: str) -> tuple[str, ...]:
        """Parameters of a cause that lie at an end of their range."""
        values = self.values()[cause]
        numbers = {u.parameter.name: u.parameter for u in self.unknowns if u.cause == cause}
        return tuple(
            name
            for name, p in numbers.items()
            if min(abs(values[name] - p.lower), abs(values[name] - p.upper)) < AT * p.size
        )


class Fitter:
    """Gauss-Newton with damping on whitened gaps, of many explanations in one batch.

    Args:
        player: Plays into the simulator.
        cut: Stretches to fit to.
        likelihood: Of their gaps.
        library: Causes to choose from.
        temper: Squares are divided by it: how much worse than noise the best is known to be.
    """

    def __init__(
        self,
        player: Player,
        cut: Stretches,
        likelihood: Likelihood,
        library: Library,
        temper: float = 1.0,
    ) -> None:
        self.player, self.cut, self.likelihood = player, cut, likelihood
        self.library, self.temper = library, temper
        self.plays = 0

    def start(self, causes: Sequence[str], place: Sequence[float] = ()) -> Fitted:
        """An explanation that is not fitted yet, at `place` or at neutral."""
        own = self.library.unknowns(causes)
        begin = list(place) or [0.0] * len(own)
        return Fitted(tuple(causes), own, torch.tensor(begin, dtype=torch.float64), torch.empty(0))

    def evaluate(self, rows: Sequence[tuple[Fitted, Tensor]]) -> list[Tensor]:
        """Whitened gaps [N, D] of explanations at places [P]."""
        if not rows:
            return []
        settings = self.library.settings([(f.unknowns, place) for f, place in rows])
        self.plays += len(rows)
        gap = self.player.play(self.cut, *settings)
        return list(self.likelihood.white(gap))

    def value(self, fitted: Fitted) -> float:
        """Loss and penalty, in nats."""
        total = self.likelihood.loss(fitted.square, self.temper).sum()
        return float(total + fitted.penalty())

    def fit(
        self, explanations: Sequence[Fitted], iterations: int = 5, worst: float | None = None
    ) -> list[Fitted]:
        """Fits all of them; the last slopes are kept.

        Args:
            explanations: Where each begins.
            iterations: At most.
            worst: Value of having none of them [nats]. Given one, those that are hopeless after
                `TRIED` iterations, by what they gain on it, are not fitted any further.
        """
        found = [
            Fitted(f.causes, f.unknowns, bounded(f.unknowns, f.place), w)
            for f, w in zip(
                explanations,
                self.evaluate([(f, bounded(f.unknowns, f.place)) for f in explanations]),
                strict=True,
            )
        ]
        open_ = list(range(len(found)))
        for iteration in range(iterations):
            if worst is not None and iteration >= TRIED:
                gains = [worst - self.value(f) for f in found]
                open_ = [i for i in open_ if gains[i] > HOPELESS * max(gains)]
            if not open_:
                break
            self.differentiate([found[i] for i in open_])
            trials = [
                (i, bounded(found[i].unknowns, place))
                for i in open_
                for place in self._steps(found[i])
            ]
            whites = self.evaluate([(found[i], place) for i, place in trials])
            moved = []
            for i in open_:
                best = self.value(found[i])
                before = best
                for (j, place), white in zip(trials, whites, strict=True):
                    if j != i:
                        continue
                    other = Fitted(found[i].causes, found[i].unknowns, place, white)
                    value = self.value(other)
                    if value < best:
                        best, found[i] = value, other
                if before - best > 1e-3 * max(1.0, abs(before)) or before - best > 0.5:
                    moved.append(i)
            open_ = moved
        self.differentiate([f for f in found if f.slopes is None])
        return found

    def differentiate(self, explanations: Sequence[Fitted]) -> None:
        """Gives explanations their slopes, by one-sided differences away from bounds."""
        rows, columns = [], []
        for fitted in explanations:
            for p in range(len(fitted.place)):
                step = torch.zeros_like(fitted.place)
                step[p] = STEP
                if not torch.equal(
                    bounded(fitted.unknowns, fitted.place + step), fitted.place + step
                ):
                    step[p] = -STEP
                rows.append((fitted, fitted.place + step))
                columns.append(float(step[p]))
        whites = self.evaluate(rows)
        position = 0
        for fitted in explanations:
            parts = []
            for _ in range(len(fitted.place)):
                parts.append((whites[position] - fitted.white) / columns[position])
                position += 1
            fitted.slopes = torch.stack(parts, -1)

    def normal(self, fitted: Fitted) -> tuple[Tensor, Tensor]:
        """Curvature [N, P, P] and score [N, P] of each stretch, without the prior."""
        assert fitted.slopes is not None
        weight = self.likelihood.weight(fitted.square, self.temper) / self.temper  # (N,)
        curve = torch.einsum("ndp,ndq,n->npq", fitted.slopes, fitted.slopes, weight)
        score = torch.einsum("ndp,nd,n->np", fitted.slopes, fitted.white, weight)
        return curve, score

    def _steps(self, fitted: Fitted):
        curve, score = self.normal(fitted)
        prior = torch.tensor([u.prior for u in fitted.unknowns], dtype=torch.float64)
        hessian = curve.sum(0) + torch.diag(prior**-2)
        gradient = score.sum(0) + fitted.place / prior**2
        for damping in DAMPINGS:
            damped = hessian + damping * torch.diag(hessian.diagonal())
            step = torch.linalg.solve(damped, gradient).clamp(-2.0, 2.0)
            yield fitted.place - step
