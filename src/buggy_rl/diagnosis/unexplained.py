"""What a hypothesis leaves unexplained: how much, in which channel, depending on what."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from buggy_rl.diagnosis.localisation import features
from buggy_rl.estimation.gauss_newton import Problem
from buggy_rl.estimation.misfit import NO_BASELINE, BaselineMisfit, misfit

BINS = 5  # of a condition, with equal shares of the instants
NAMED = 3  # conditions that are named at most
CLIPPED = 25.0  # [noise variances] as which a single reading counts at most
REMEMBERED = 0.3  # [-] correlation of neighbouring instants from which a latent state is likely
READINGS = ("x", "y", "yaw", "vx", "vy", "yaw_rate")


@dataclass(frozen=True)
class Unexplained:
    """What a hypothesis leaves."""

    excess: float
    """Excess misfit."""
    share: float
    """Of the excess that there was at first."""
    channel: dict[str, float]
    """Share of each channel in it."""
    depends_on: list[str]
    """Conditions that it grows with, the most significant first."""
    memory: bool
    """Whether residuals persist from instant to instant, as those of a latent state do."""
    unclosed: float = 0.0
    """Share of the excess beyond the baseline's that is expected to remain, however little."""


def unexplained(
    problem: Problem,
    before: Tensor,
    after: Tensor,
    depends_share: float,
    usual: BaselineMisfit = NO_BASELINE,
) -> Unexplained:
    """Compares whitened residuals [N, D] before and after a hypothesis.

    Args:
        problem: Its segments and instants.
        before: Of the simulator as given.
        after: Of the hypothesis.
        depends_share: Share of the variance that a condition must explain to be named.
        usual: Excess misfit that counts as none.
    """
    given = before.square().mean(-1)
    first, last = (misfit(w.square().mean(-1), given) - 1 for w in (before, after))
    over = usual.beyond(last)
    readings = after.view(len(after), -1, 6)  # (N, K, 6)
    square = readings.square().clamp_max(CLIPPED)
    of_channel = (square.mean((0, 1)) - 1).clamp_min(0.0)
    total = float(of_channel.sum()) or 1.0
    now, then = readings[:, 1:, 3:].flatten(), readings[:, :-1, 3:].flatten()
    along = float((now * then).mean() / (now.square().mean() + 1e-12))
    return Unexplained(
        excess=last,
        share=last / max(first, last) if last > usual.most else 0.0,
        channel={n: float(v) / total for n, v in zip(READINGS, of_channel.tolist(), strict=True)},
        depends_on=_depends_on(problem, square.sum(-1), depends_share),
        memory=along > REMEMBERED,
        unclosed=over / max(first - usual.mean, over) if over > 0 else 0.0,
    )


def by_condition(problem: Problem, square: Tensor) -> dict[str, float]:
    """Condition -> share of the variance of the squares [N, K] that is between its bins."""
    target = square.flatten().numpy()
    instants = problem.simulation.instants(problem.segments)
    return {
        name: _explained(target, value.flatten().numpy())
        for name, value in features(problem.segments, instants).items()
    }


def _depends_on(problem: Problem, square: Tensor, least: float) -> list[str]:
    """Conditions whose bins explain the squares [N, K], the most significant first."""
    ranked = sorted(by_condition(problem, square).items(), key=lambda item: -item[1])
    return [name for name, share in ranked if share > least][:NAMED]


def _explained(target: NDArray, condition: NDArray) -> float:
    """Share of the target's variance between bins of a condition."""
    edges = np.unique(np.quantile(condition, np.linspace(0, 1, BINS + 1)[1:-1]))
    index = np.digitize(condition, edges)
    means = np.array([target[index == b].mean() for b in np.unique(index)])
    share = np.array([(index == b).mean() for b in np.unique(index)])
    return float((share * (means - target.mean()) ** 2).sum() / (target.var() or 1.0))
