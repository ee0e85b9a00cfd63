"""The effect whose trace is most like the motion that single steps lack."""

from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from buggy_rl.blind_test.baselines.answers import named, unnamed
from buggy_rl.blind_test.baselines.asked import asked
from buggy_rl.blind_test.baselines.columns import Columns, columns

SHUFFLES = 200  # of the segments, to see what chance alone brings about
LEVEL = 0.99  # of their largest correlations, above which one is none of chance


def correlation(seen: Path) -> dict[str, Any]:
    """Names the effect with the largest correlation, if that is above what chance brings.

    rho_f = <r, c_f> / (|r| |c_f|) with the columns c_f of `columns`, each channel about its mean;
    a negative one counts only where an effect has two directions. Chance is the largest rho of all
    effects when the segments of r are in another order than those of c. The confidence is a
    softmax of the explained share: exp(-n/2 ln(1 - rho^2)) over the sum of all effects', with n
    segments as independent. The size is <r, c> / <c, c>.

    Baseline drives are used as the diagnosis uses them: the simulator is corrected by a small
    network first.
    """
    found = columns(asked(seen))
    rho = correlations(found)
    best = int(rho.argmax())
    chance = by_chance(found)
    if float(rho[best]) <= chance:
        return unnamed("no_mismatch", f"the largest is {float(rho[best]):.3f}, chance {chance:.3f}")
    feature = found.features[best]
    numbers = feature.numbers(*_slope(found, best))
    note = f"correlation {float(rho[best]):.3f}, by chance up to {chance:.3f}"
    return named("missing_physics", feature.effect, _sure(found, rho, best), numbers, [note])


def correlations(found: Columns) -> Tensor:
    """[F] those of the features, absolute where there are two directions, at least 0."""
    x, y = _normal(found.explained), _normal(found.lacking[None])[0]
    return _counted(found, x @ y)


def by_chance(found: Columns) -> float:
    """The largest correlation when the segments are shuffled, at `LEVEL`."""
    x, y = _normal(found.explained), _centred(found.lacking[None])[0]
    generator = torch.Generator().manual_seed(0)
    largest = []
    for _ in range(SHUFFLES):
        order = torch.randperm(len(y), generator=generator)
        shuffled = y[order].flatten()
        largest.append(_counted(found, x @ shuffled / shuffled.norm().clamp_min(1e-12)).max())
    return float(torch.stack(largest).quantile(LEVEL))


def _counted(found: Columns, rho: Tensor) -> Tensor:
    both = torch.tensor([feature.both_ways for feature in found.features])
    return torch.where(both, rho.abs(), rho.clamp_min(0.0))


def _centred(signal: Tensor) -> Tensor:
    """Each channel of signals [F, N, K, 6] about its mean."""
    return signal - signal.mean((1, 2), keepdim=True)


def _normal(signal: Tensor) -> Tensor:
    """Centred signals [F, N, K, 6] of length one [F, N * K * 6]."""
    flat = _centred(signal).flatten(1)
    return flat / flat.norm(dim=1, keepdim=True).clamp_min(1e-12)


def _slope(found: Columns, best: int) -> tuple[float, float]:
    """<r, c> / <c, c> and its standard deviation."""
    x, y = _centred(found.explained[best : best + 1]).flatten(), _centred(found.lacking[None])[0]
    y = y.flatten()
    slope = x @ y / (x @ x)
    spread = ((y - slope * x).square().sum() / (len(y) - 1) / (x @ x)).sqrt()
    return float(slope), float(spread)


def _sure(found: Columns, rho: Tensor, best: int) -> float:
    """Share of the best effect among all, each at its best feature."""
    nats = -0.5 * len(found.lacking) * torch.log1p(-rho.square().clamp_max(1 - 1e-9))
    of: dict[str, Tensor] = {}
    for feature, value in zip(found.features, nats, strict=True):
        of[feature.effect] = torch.maximum(of.get(feature.effect, value), value)
    share = torch.softmax(torch.stack(list(of.values())), 0)
    return float(share[list(of).index(found.features[best].effect)])
