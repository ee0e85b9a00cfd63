"""Is what remains noise? And if not: how much, in which channel, growing with what?"""

import math
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from buggy_rl.diagnosis.localisation import features
from buggy_rl.estimation.misfit import NOTHING_USUAL, Usual, misfit
from buggy_rl.estimation.segments import Stretches

BINS = 5
TELLING = 0.05  # share of the remaining variance that a feature must explain to be named


@dataclass(frozen=True)
class Remaining:
    """What an explanation leaves over."""

    excess: float
    """Size of whitened gaps over that of noise, less one (see `misfit`)."""
    share: float
    """Of the excess that there was at first."""
    channel: dict[str, float]
    """Share of each channel in what remains."""
    depends_on: list[str]
    """What it grows with, most telling first."""
    memory: bool
    """Whether gaps go on from instant to instant as a hidden state's would."""
    unclosed: float = 0.0
    """Share of the excess beyond the usual that is expected to remain, however little that is."""


def _expected(over: float, error: float) -> float:
    """What is over, of which drives differ by themselves, where there cannot be less than none.

    E[max(0, x)], x ~ N(over, error^2): over Phi(over / error) + error phi(over / error).
    """
    if error <= 0:
        return max(0.0, over)
    ratio = over / error
    below = 0.5 * math.erfc(ratio / math.sqrt(2))
    density = math.exp(-0.5 * ratio**2) / math.sqrt(2 * math.pi)
    return over * (1 - below) + error * density


def remaining(
    cut: Stretches, instants: Tensor, before: Tensor, after: Tensor, usually: Usual = NOTHING_USUAL
) -> Remaining:
    """Looks at whitened gaps [N, D] before and after an explanation.

    Whitened gaps are compared row by row with what was driven: the share of their square that
    bins of a feature explain, over what as many random bins would. An excess that is usual is none.
    """
    given = before.square().mean(-1)
    first, last = (misfit(w.square().mean(-1), given) - 1 for w in (before, after))
    over = _expected(last - usually.mean, usually.error)
    count = len(after)
    readings = after.view(count, -1, 6)  # (N, K, 6)
    square = readings.square().clamp_max(25.0)
    of_channel = (square.mean((0, 1)) - 1).clamp_min(0.0)
    names = ("x", "y", "yaw", "vx", "vy", "yaw_rate")
    total = float(of_channel.sum()) or 1.0
    told = {}
    target = square.sum(-1).flatten().numpy()
    spread = target.var() or 1.0
    for name, value in features(cut, instants).items():
        x = value.flatten().numpy()
        edges = np.unique(np.quantile(x, np.linspace(0, 1, BINS + 1)[1:-1]))
        bin_ = np.digitize(x, edges)
        means = np.array([target[bin_ == b].mean() for b in np.unique(bin_)])
        share = np.array([(bin_ == b).mean() for b in np.unique(bin_)])
        told[name] = float((share * (means - target.mean()) ** 2).sum() / spread)
    depends = [n for n, v in sorted(told.items(), key=lambda i: -i[1]) if v > TELLING][:3]
    now, then = readings[:, 1:, 3:].flatten(), readings[:, :-1, 3:].flatten()
    along = float((now * then).mean() / (now.square().mean() + 1e-12))
    return Remaining(
        excess=last,
        share=last / max(first, last) if last > usually.most else 0.0,
        channel={n: float(v) / total for n, v in zip(names, of_channel.tolist(), strict=True)},
        depends_on=depends,
        memory=along > 0.3,
        unclosed=over / max(first - usually.mean, over) if over > 0 else 0.0,
    )
