"""What steps of a simulator lack beside what each effect would change, and their correlation.

A method that does not roll out looks at single steps: the measured motion is imposed at every row,
and what the simulator's next state is off by, per second, is the motion it lacks,

r_k = (x_{k+1} - f(x_k, u_k)) / dt,   x = (pose in the body frame, velocity),

smoothed and averaged over `SPAN` rows, in units of the sensor's noise. The same with an effect of
one prior scale in the simulator is r'; what the effect explains is the column r - r'. An effect on
the sensing changes x instead of f. If the car had the effect in that size, r' would be noise.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from buggy_rl.core.vehicle import rotate
from buggy_rl.effects import EFFECTS, effect_class
from buggy_rl.estimation.evidence import CAP
from buggy_rl.estimation.hypothesis import Coordinate, Library
from buggy_rl.estimation.noise_model import NoiseModel, sensor_noise
from buggy_rl.estimation.rollout import ParameterSets, Simulation
from buggy_rl.estimation.segments import AHEAD, Segments, cut_segments
from buggy_rl.proof.baselines.asked import Asked, named, open_question, parameter_interval, unnamed
from buggy_rl.task.augment import effects_of

SPAN = 10  # rows (0.1 s) whose mean is one number: shorter drowns in the noise of a derivative
SECONDS = 1.0  # of a segment, before which latent states settle
PLACES = 16  # columns of a patch: one for each place at which it is tried
DELAYED = ("throttle_dead_time", "steering_dead_time", "sensor_latency")
DELAYS = (0.03, 0.06, 0.09, 0.12, 0.15)  # [s] of command and reading: a column for each


@dataclass(frozen=True)
class Feature:
    """A column: one effect, or one number of it, at a trial size."""

    effect: str
    coordinates: tuple[Coordinate, ...]
    vector: tuple[float, ...]
    """Coordinates of the trial; a coefficient of the column is in units of it."""
    scaled: tuple[bool, ...]
    """Whether each coordinate grows with the coefficient; the others are what they are."""
    both_ways: bool
    """Whether a negative coefficient makes sense."""

    def numbers(self, coefficient: float, spread: float) -> dict[str, dict[str, Any]]:
        """Values of the effect's parameters with their 95 % intervals."""
        return {
            u.parameter.name: parameter_interval(u.parameter, coefficient * z, spread * abs(z))
            if scaled
            else parameter_interval(u.parameter, z, 0.0)
            for u, z, scaled in zip(self.coordinates, self.vector, self.scaled, strict=True)
            if z or not scaled
        }


@dataclass(frozen=True)
class Columns:
    """N segments with K spans each, of six channels: rates of x, y, yaw, vx, vy, yaw_rate."""

    features: list[Feature]
    lacking: Tensor
    """[N, K, 6] motion that the steps lack, in units of the noise."""
    explained: Tensor
    """[F, N, K, 6] the part of it that each feature explains at its trial size."""


@lru_cache(maxsize=1)
def residual_columns(asked: Asked) -> Columns:
    """Residual motion of a case and what its library's effects would make of it; kept for one."""
    simulation = asked.corrected
    inside = [effect.name for effect in effects_of(simulation.make(1))]
    library = Library([e for e in asked.config.effects or EFFECTS if e not in inside], own=False)
    dt = asked.recordings[0].dt
    segments = cut_segments(asked.recordings, SECONDS + AHEAD * dt, SECONDS)
    segments = segments.spread(asked.config.stretches)
    found = [
        feature for name in library.effects for feature in effect_columns(library, name, segments)
    ]
    hypotheses = [
        library.hypothesis(()),
        *(library.hypothesis([f.effect], [*f.vector, 0.0]) for f in found),
    ]
    settings = library.settings([(h, h.vector) for h in hypotheses])
    rates = lacking_motion(simulation, segments, ParameterSets(settings.effects))
    if not bool(rates.isfinite().all()):
        raise FloatingPointError(f"{asked.config.simulator}: a step is not finite")
    spans = rates.unflatten(2, (-1, SPAN)).mean(3) * (SPAN * dt / sensor_noise(segments))
    return Columns(found, spans[0].double(), (spans[:1] - spans[1:]).double())


def effect_columns(library: Library, effect: str, segments: Segments) -> list[Feature]:
    """Columns of an effect: one, or one for each part of a vector, place of a patch, or delay."""
    coordinates = library.hypothesis([effect]).coordinates[:-1]  # without the clock
    numbers = [u.parameter for u in coordinates]
    deciding = effect_class(effect).deciding
    both_ways = all(p.lower < p.value < p.upper for p in numbers if p.name in (deciding or p.name))
    if effect in DELAYED:  # which does not linearise
        scaled = (True,)
        [p] = numbers
        vectors = [[float(p.coordinate(delay))] for delay in DELAYS if delay <= p.upper]
    elif deciding:  # the others say where
        scaled = tuple(p.name in deciding for p in numbers)
        vectors = library.trials(effect, segments)[:PLACES]
    elif len(numbers) > 1 and both_ways:
        scaled = (True,) * len(numbers)
        vectors = torch.eye(len(numbers)).tolist()
    else:
        scaled = (True,) * len(numbers)
        vectors = [[math.copysign(1.0, p.coordinate(p.value + p.probe)) for p in numbers]]
    return [Feature(effect, coordinates, tuple(vector), scaled, both_ways) for vector in vectors]


@torch.no_grad()
def lacking_motion(simulation: Simulation, segments: Segments, settings: ParameterSets) -> Tensor:
    """Rates [C, N, H, 6] that single steps lack to follow the measured motion.

    Args:
        simulation: Of the simulator.
        segments: N segments of H rows after the warm-up, and `AHEAD` for sensors that report late.
        settings: Of C sets.
    """
    rates = []
    for _, (now, following), after in simulation.single_steps(segments, settings):
        short = following - after
        position = rotate(short[:, :2], -now[:, 2])
        rates.append(torch.cat([position, short[:, 2:]], -1) / segments.dt)
    rates = rates[: segments.horizon - AHEAD]
    return torch.stack(rates, 1).view(len(settings), len(segments), len(rates), 6)


def roots(noise: NoiseModel, residual: Tensor) -> Tensor:
    """|W e| / sqrt(D) [C, N] of residuals [C, N, K, 6], at most sqrt(`CAP`); 1 is noise."""
    return noise.whiten(residual).square().mean(-1).clamp_max(CAP).sqrt()


SHUFFLES = 200  # of the segments, to see what chance alone brings about
LEVEL = 0.99  # of their largest correlations, above which one is none of chance


def correlation(seen: Path) -> dict[str, Any]:
    """Names the effect with the largest correlation, if that is above what chance brings.

    rho_f = <r, c_f> / (|r| |c_f|) with the columns c_f of `residual_columns`, each channel about
    its mean; a negative one counts only where an effect has two directions. Chance is the largest
    rho of all
    effects when the segments of r are in another order than those of c. The confidence is a
    softmax of the explained share: exp(-n/2 ln(1 - rho^2)) over the sum of all effects', with n
    segments as independent. The size is <r, c> / <c, c>.

    Baseline drives are used as the diagnosis uses them: the simulator is corrected by a small
    network first.
    """
    found = residual_columns(open_question(seen))
    rho = feature_correlations(found)
    best = int(rho.argmax())
    chance = by_chance(found)
    if float(rho[best]) <= chance:
        return unnamed("no_mismatch", f"the largest is {float(rho[best]):.3f}, chance {chance:.3f}")
    feature = found.features[best]
    numbers = feature.numbers(*_slope(found, best))
    note = f"correlation {float(rho[best]):.3f}, by chance up to {chance:.3f}"
    return named("missing_physics", feature.effect, _sure(found, rho, best), numbers, [note])


def feature_correlations(found: Columns) -> Tensor:
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
