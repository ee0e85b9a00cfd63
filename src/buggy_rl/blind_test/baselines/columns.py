"""What each step of a simulator lacks, and what each effect of the library would change in it.

A method that does not roll out looks at single steps: the measured motion is imposed at every row,
and what the simulator's next state is off by, per second, is the motion it lacks,

r_k = (x_{k+1} - f(x_k, u_k)) / dt,   x = (pose in the body frame, velocity),

smoothed and averaged over `SPAN` rows, in units of the sensor's noise. The same with an effect of
a typical size in the simulator is r'; what the effect explains is the column r - r'. An effect on
the sensing changes x instead of f. If it were the cause in that size, r' would be noise.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor

from buggy_rl import keys
from buggy_rl.blind_test.baselines.answers import number
from buggy_rl.blind_test.baselines.asked import Asked, spread
from buggy_rl.effects import EFFECTS, effect_class
from buggy_rl.effects.actuation.command import RememberingCommand
from buggy_rl.estimation.hypothesis import Library, Unknown
from buggy_rl.estimation.rollout import Player, Values, effects_of, explained
from buggy_rl.estimation.segments import AHEAD, WARM_UP, Stretches, sensor_noise, stretches
from buggy_rl.vehicle import rotate

SPAN = 10  # rows (0.1 s) whose mean is one number: shorter drowns in the noise of a derivative
SECONDS = 1.0  # of a stretch, before which hidden states settle
PLACES = 16  # columns of an effect that has a place: one for each place at which it is tried


@dataclass(frozen=True)
class Feature:
    """A column: one effect, or one number of it, at a trial size."""

    cause: str
    unknowns: tuple[Unknown, ...]
    place: tuple[float, ...]
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
            for u, z, scaled in zip(self.unknowns, self.place, self.scaled, strict=True)
            if z or not scaled
        }


@dataclass(frozen=True)
class Columns:
    """N stretches with K spans each, of six channels: rates of x, y, yaw, vx, vy, yaw_rate."""

    features: list[Feature]
    lacking: Tensor
    """[N, K, 6] motion that the steps lack, in units of the noise."""
    explained: Tensor
    """[F, N, K, 6] the part of it that each feature explains at its trial size."""


@lru_cache(maxsize=1)
def columns(asked: Asked) -> Columns:
    """Residual motion of a case and what its library's effects would make of it; kept for one."""
    player = asked.corrected
    inside = [effect.name for effect in effects_of(player.make(1))]
    library = Library([e for e in asked.config.effects or EFFECTS if e not in inside], own=False)
    dt = asked.recordings[0].dt
    cut = stretches(asked.recordings, SECONDS + AHEAD * dt, SECONDS)
    cut = spread(cut, asked.config.stretches)
    found = [feature for name in library.effects for feature in features(library, name, cut)]
    still = (library.unknowns(()), torch.zeros(1))
    trials = [
        (library.unknowns([f.cause]), torch.tensor([*f.place, 0.0], dtype=torch.float64))
        for f in found
    ]
    rates = lacking_motion(player, cut, library.settings([still, *trials])[0])
    if not bool(rates.isfinite().all()):
        raise FloatingPointError(f"{asked.config.simulator}: a step is not finite")
    spans = rates.unflatten(2, (-1, SPAN)).mean(3) * (SPAN * dt / sensor_noise(cut))
    return Columns(found, spans[0].double(), (spans[:1] - spans[1:]).double())


def features(library: Library, cause: str, cut: Stretches) -> list[Feature]:
    """Columns of an effect: one, or one for each part of a vector, or each place of a patch."""
    unknowns = library.unknowns([cause])[:-1]  # without the clock
    numbers = [u.parameter for u in unknowns]
    deciding = effect_class(cause).deciding
    both_ways = all(p.lower < p.value < p.upper for p in numbers if p.name in (deciding or p.name))
    if deciding:  # the others say where
        scaled = tuple(p.name in deciding for p in numbers)
        places = library.trials(cause, cut)[:PLACES]
    elif len(numbers) > 1 and both_ways:
        scaled = (True,) * len(numbers)
        places = torch.eye(len(numbers)).tolist()
    else:
        scaled = (True,) * len(numbers)
        places = [[math.copysign(1.0, p.coordinate(p.value + p.probe)) for p in numbers]]
    return [Feature(cause, unknowns, tuple(place), scaled, both_ways) for place in places]


@torch.no_grad()
def lacking_motion(player: Player, cut: Stretches, effects: Values) -> Tensor:
    """Rates [C, N, H, 6] that single steps lack to follow the measured motion.

    Args:
        player: Plays into the simulator.
        cut: N stretches of H rows after the warm-up, and `AHEAD` for sensors that report late.
        effects: Values [C] of each effect's parameters.
    """
    sets = len(next(iter(next(iter(effects.values())).values())))
    count = len(cut)
    each = {e: {p: v.repeat_interleave(count) for p, v in ps.items()} for e, ps in effects.items()}
    simulator = player.make(sets * count)
    env, stack = explained(simulator, each, {}, player.standing, player.options)
    pose, velocity = (x.repeat(sets, 1, 1) for x in (cut.smooth_pose, cut.smooth_velocity))
    for effect in reversed(stack):
        pose, velocity = effect.unsensed(pose, velocity, cut.dt)
    action, elapsed = cut.action.repeat(sets, 1, 1), cut.elapsed.repeat(sets).unsqueeze(-1)
    start = TensorDict({keys.POSE: pose[:, 0], keys.VELOCITY: velocity[:, 0]}, [sets * count])
    state = env.reset(start)
    if keys.ELAPSED in state.keys():  # noqa: SIM118  TensorDict has no `in`
        state[keys.ELAPSED] = elapsed
    for effect in stack:
        if isinstance(effect, RememberingCommand) and effect.lasting and effect.active:
            told = cut.earlier[..., effect.channel].repeat(sets, 1)
            state[effect.memory] = effect.remembered(state[effect.memory], told)
    rates = []
    for row in range(pose.shape[1] - 1 - AHEAD):
        state[keys.POSE], state[keys.VELOCITY] = pose[:, row], velocity[:, row]
        state[keys.ACTION] = action[:, row]
        state = env.step(state)["next"]
        if row >= WARM_UP:
            moved = pose[:, row + 1] - state[keys.POSE]
            place = rotate(moved[:, :2], -pose[:, row, 2])
            faster = velocity[:, row + 1] - state[keys.VELOCITY]
            rates.append(torch.cat([place, moved[:, 2:], faster], -1) / cut.dt)
    return torch.stack(rates, 1).view(sets, count, len(rates), 6)
