"""What each step of a simulator lacks, and what each effect of the library would change in it.

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
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor

from buggy_rl.blind_test.baselines.answers import number
from buggy_rl.blind_test.baselines.asked import Asked
from buggy_rl.effects import EFFECTS, effect_class
from buggy_rl.estimation.hypothesis import Coordinate, Library
from buggy_rl.estimation.rollout import Settings, Simulation
from buggy_rl.estimation.segments import AHEAD, Segments, cut_segments
from buggy_rl.estimation.sensor_noise import sensor_noise
from buggy_rl.task.augment import effects_of
from buggy_rl.vehicle import rotate

SPAN = 10  # rows (0.1 s) whose mean is one number: shorter drowns in the noise of a derivative
SECONDS = 1.0  # of a segment, before which latent states settle
PLACES = 16  # columns of a patch: one for each place at which it is tried


@dataclass(frozen=True)
class Feature:
    """A column: one effect, or one number of it, at a trial size."""

    effect: str
    coordinates: tuple[Coordinate, ...]
    vector: tuple[float, ...]
    """Coordinates of the trial; a coefficient of the column is in units of it."""
    scaled: tuple[bool, ...]
    """Which of them grow with the coefficient; the others are what they are."""
    both_ways: bool
    """Whether a negative coefficient makes sense."""

    def numbers(self, coefficient: float, spread: float) -> dict[str, dict[str, Any]]:
        """Values of the effect's parameters with their 95 % intervals."""
        return {
            u.parameter.name: number(u.parameter, coefficient * z, spread * abs(z))
            if scaled
            else number(u.parameter, z, 0.0)
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
def columns(asked: Asked) -> Columns:
    """Residual motion of a case and what its library's effects would make of it; kept for one."""
    simulation = asked.corrected
    inside = [effect.name for effect in effects_of(simulation.make(1))]
    library = Library([e for e in asked.config.effects or EFFECTS if e not in inside], own=False)
    dt = asked.recordings[0].dt
    segments = cut_segments(asked.recordings, SECONDS + AHEAD * dt, SECONDS)
    segments = segments.spread(asked.config.stretches)
    found = [feature for name in library.effects for feature in features(library, name, segments)]
    hypotheses = [
        library.hypothesis(()),
        *(library.hypothesis([f.effect], [*f.vector, 0.0]) for f in found),
    ]
    settings = library.settings([(h, h.vector) for h in hypotheses])
    rates = lacking_motion(simulation, segments, Settings(settings.effects))
    if not bool(rates.isfinite().all()):
        raise FloatingPointError(f"{asked.config.simulator}: a step is not finite")
    spans = rates.unflatten(2, (-1, SPAN)).mean(3) * (SPAN * dt / sensor_noise(segments))
    return Columns(found, spans[0].double(), (spans[:1] - spans[1:]).double())


def features(library: Library, effect: str, segments: Segments) -> list[Feature]:
    """Columns of an effect: one, or one for each part of a vector, or each place of a patch."""
    coordinates = library.hypothesis([effect]).coordinates[:-1]  # without the clock
    numbers = [u.parameter for u in coordinates]
    deciding = effect_class(effect).deciding
    both_ways = all(p.lower < p.value < p.upper for p in numbers if p.name in (deciding or p.name))
    if deciding:  # the others say where
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
def lacking_motion(simulation: Simulation, segments: Segments, settings: Settings) -> Tensor:
    """Rates [C, N, H, 6] that single steps lack to follow the measured motion.

    Args:
        simulation: Of the simulator.
        segments: N segments of H rows after the warm-up, and `AHEAD` for sensors that report late.
        settings: Of C sets.
    """
    steps = list(simulation.single_steps(segments, settings))
    rates = []
    for (_, now, after), (_, following, _) in pairwise(steps):
        short = following - after
        position = rotate(short[:, :2], -now[:, 2])
        rates.append(torch.cat([position, short[:, 2:]], -1) / segments.dt)
    rates = rates[: segments.horizon - AHEAD]
    return torch.stack(rates, 1).view(len(settings), len(segments), len(rates), 6)
