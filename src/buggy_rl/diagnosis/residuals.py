"""Residuals of rollouts: their conditions in numbers and words, and what is unexplained."""

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from buggy_rl.estimation.evidence import NO_BASELINE, BaselineMisfit, misfit
from buggy_rl.estimation.gauss_newton import Problem
from buggy_rl.estimation.rollout import AS_GIVEN, ParameterSets, Simulation
from buggy_rl.estimation.segments import Segments

STEERED = 0.1  # [s] over which the rate of the steering command is taken
SHORT = 0.3  # [s] within which an error stays where it began
LARGE = 50.0  # times the noise, as which a change of a residual counts at most


def drive_features(segments: Segments, instants: Tensor) -> dict[str, Tensor]:
    """What was driven at the instants [N, K], from smoothed measurements."""
    rows = segments.start + instants
    pose, velocity, action = (
        segments.smooth_pose[:, rows],
        segments.smooth_velocity[:, rows],
        segments.action,
    )
    back = max(1, round(STEERED / segments.dt))
    past = action[:, rows - back]
    return {
        "vx": velocity[..., 0],
        "steering": action[:, rows, 1],
        "throttle": action[:, rows, 0],
        "steering_rate": (action[:, rows, 1] - past[..., 1]) / (back * segments.dt),
        "lateral_acceleration": velocity[..., 0] * velocity[..., 2],
        "heading": torch.atan2(torch.sin(pose[..., 2]), torch.cos(pose[..., 2])),
        "elapsed": segments.elapsed[:, None] + rows * segments.dt,
        "x": pose[..., 0],
        "y": pose[..., 1],
    }


def charged(
    simulation: Simulation, segments: Segments, noise: Tensor, settings: ParameterSets = AS_GIVEN
) -> tuple[Tensor, Tensor]:
    """Errors of short rollouts, each instant charged its own.

    How far a velocity's residual changed since the instant before, in noise standard deviations:
    an error is charged where it arises, not where it has grown to.

    Args:
        simulation: Plays into the simulator.
        segments: Segments of drives.
        noise: [6] of a reading.
        settings: One parameter set of the simulator.

    Returns:
        Changes [N, K, 3] of vx, vy and yaw_rate, and the rows [K] after the start they are at.
    """
    fine = replace(simulation, every=max(1, round(SHORT / segments.dt / 3)))
    residual = fine.residuals(segments, settings)[0].double()[..., 3:]  # (N, K, 3)
    change = torch.cat([torch.zeros_like(residual[:, :1]), residual], 1).diff(dim=1) / noise[3:]
    return change.nan_to_num(LARGE).clamp(-LARGE, LARGE), fine.instants(segments)


CONDITION_BINS = 5  # of a condition, with equal shares of the instants
NAMED = 3  # conditions that are named at most
CLIPPED = 25.0  # [noise variances] as which a single reading counts at most
REMEMBERED = 0.3  # [-] correlation of neighbouring instants from which a latent state is likely


@dataclass(frozen=True)
class Unexplained:
    """What a hypothesis leaves."""

    excess: float
    """Excess misfit."""
    share: float
    """Share of the excess that there was at first."""
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
        for name, value in drive_features(problem.segments, instants).items()
    }


def _depends_on(problem: Problem, square: Tensor, least: float) -> list[str]:
    """Conditions whose bins explain the squares [N, K], the most significant first."""
    ranked = sorted(by_condition(problem, square).items(), key=lambda item: -item[1])
    return [name for name, share in ranked if share > least][:NAMED]


def _explained(target: NDArray, condition: NDArray) -> float:
    """Share of the target's variance between bins of a condition."""
    edges = np.unique(np.quantile(condition, np.linspace(0, 1, CONDITION_BINS + 1)[1:-1]))
    index = np.digitize(condition, edges)
    means = np.array([target[index == b].mean() for b in np.unique(index)])
    share = np.array([(index == b).mean() for b in np.unique(index)])
    return float((share * (means - target.mean()) ** 2).sum() / (target.var() or 1.0))


@dataclass(frozen=True)
class Condition:
    """A quantity of what was driven."""

    words: str
    """Words in a sentence."""
    unit: str = ""
    listed: str = ""
    """Words in the report's list of regions; empty for `words`."""
    listed_unit: str = ""
    """The unit there; empty for `unit`."""
    scale: float = 1.0
    """How many of the unit of the report are 1 of what is computed with."""
    varying: str = ""
    """Words for a segment's mean, with which an effect's numbers vary; empty for `words`."""


CONDITIONS = {
    "vx": Condition("speed", "m/s"),
    "acceleration": Condition("longitudinal acceleration", "m/s^2"),
    "throttle": Condition("throttle", listed="throttle command"),
    "steering": Condition(
        "steering", listed="steering command", varying="the side that is steered to"
    ),
    "abs_steering": Condition("the magnitude of the steering command"),
    "steering_rate": Condition(
        "steering rate", "1/s", listed_unit="commands/s", varying="how fast the steering moves"
    ),
    "lateral_acceleration": Condition(
        "lateral acceleration", "m/s^2", varying="the side of the lateral acceleration"
    ),
    "abs_lateral_acceleration": Condition("lateral acceleration", "m/s^2"),
    "heading": Condition("heading", "°", scale=180 / math.pi),
    "heading_x": Condition("heading"),
    "heading_y": Condition("heading"),
    "elapsed": Condition("time since the start", "s"),
    "x": Condition("position", "m", listed="position x"),
    "y": Condition("position", "m", listed="position y"),
}
"""Name of `drive_features`, or of `constancy.conditions` -> its words."""


@dataclass(frozen=True)
class ReadingWords:
    """A reading of the sensor."""

    words: str
    unit: str
    fault: str = ""
    """Words for what a simulator gets wrong to one side; empty for `words`."""
    listed: str = ""
    """Words in the report; empty for `words`."""


READINGS = {
    "x": ReadingWords("longitudinal position", "m"),
    "y": ReadingWords("lateral position", "m"),
    "yaw": ReadingWords("heading", "rad"),
    "vx": ReadingWords("longitudinal speed", "m/s", "speed", "longitudinal speed (vx)"),
    "vy": ReadingWords("lateral speed", "m/s", listed="lateral speed (vy)"),
    "yaw_rate": ReadingWords("yaw rate", "rad/s"),
}
