"""Re-tuning alone: fits the parameters that the simulator declares, and blames what moved most."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torchrl.envs import EnvBase

from buggy_rl.diagnosis.answer.retuning import tuned as fitted_to
from buggy_rl.diagnosis.config import DEFAULTS
from buggy_rl.diagnosis.repair.validation import segment_folds
from buggy_rl.effects.base import EffectParameter
from buggy_rl.effects.residual import ResidualAcceleration
from buggy_rl.estimation.baseline import lacking_acceleration, trained
from buggy_rl.estimation.evidence import (
    BLOCK,
    NOTHING,
    advantage,
    blocks,
    cross_validated,
    mean_of_blocks,
)
from buggy_rl.estimation.gauss_newton import Problem, fitted
from buggy_rl.estimation.hypothesis import OWN, Library
from buggy_rl.estimation.noise_model import noise_model
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import Segments
from buggy_rl.proof.baselines.asked import Asked, named, open_question, parameter_interval, unnamed
from buggy_rl.proof.baselines.columns import roots
from buggy_rl.proof.cases.equivalents import meant

MOVED = 0.1  # [prior scales] by which a parameter must have moved to be wrong
CERTAINLY_MOVED = 2.0  # [standard deviations] by which it must have moved as well


@dataclass(frozen=True)
class Move:
    """Move of one parameter."""

    parameter: EffectParameter
    """Parameter as it was before."""
    coordinate: float
    """Coordinate that it came to [prior scales]."""
    spread: float
    """Standard deviation of that."""

    @property
    def certain(self) -> bool:
        """Whether it is no chance; never, where the spread is not a number."""
        return abs(self.coordinate) >= CERTAINLY_MOVED * self.spread


def farthest(moves: Sequence[Move], *notes: str) -> dict[str, Any]:
    """The answer: the parameter that moved most in prior scales, of those that are certain.

    Where none is, because they trade against one another, it is the one of all that moved most.
    A parameter that is an effect by another name (`SAME`) is called by that, without its number,
    which is of another kind. The confidence is its share of the way that they went.
    """
    far = [move for move in moves if abs(move.coordinate) >= MOVED]
    if not far:
        return unnamed("no_mismatch", *notes, "no parameter has moved")
    far = [move for move in far if move.certain] or far
    first = max(far, key=lambda move: abs(move.coordinate))
    own = OWN + first.parameter.name
    name = meant(own)
    value = parameter_interval(first.parameter, first.coordinate, first.spread)
    share = abs(first.coordinate) / sum(abs(move.coordinate) for move in far)
    told = f"{first.parameter.name} is {value['value']:.4g}, not {first.parameter.value:.4g}"
    numbers = {first.parameter.name: value} if name == own else {}
    return named("wrong_parameters", name, share, numbers, [*notes, told])


SEGMENTS = 24  # of a second, spread evenly: a simulator declares up to 43 parameters
CERTAIN = 3.0  # [standard errors] within which a misfit is that of the baseline
LEAST = 6.0  # [nats] gained on what was held out, above which something is wrong; chosen
ROUNDS, ITERATIONS = 2, 2  # of the fit: between rounds the dispersion is estimated anew


@dataclass(frozen=True)
class Tuned:
    """A simulator whose parameters were all fitted to some recordings."""

    moves: list[Move]
    gain: float
    """Gain on what was held out, over the simulator as it was [nats]."""

    @property
    def values(self) -> dict[str, float]:
        """Values of all parameters."""
        return {m.parameter.name: float(m.parameter.value_at(m.coordinate)) for m in self.moves}


def retune(seen: Path) -> dict[str, Any]:
    """Names the parameter that moved most, in prior scales: see `farthest`.

    Every parameter that the simulator declares is fitted to rollouts of a second, about what it
    is, also where the question keeps them from the diagnosis. Where that does not help on what was
    held out, nothing is named. With a baseline the parameters are fitted to that first, and what
    counts is how they move from there. The confidence is the share of the way that all went.

    A simulator that declares nothing cannot be re-tuned: the answer is `no_mismatch` where it
    predicts the recordings, `cannot_tell` where it does not.
    """
    question = open_question(seen)
    make = question.maker()
    if not getattr(make(1), "declared", {}):
        return _as_given(question, Simulation(make))
    if question.baseline:
        before = question.segments(question.baseline, SEGMENTS)
        make = question.maker(_tuned(make, before).values)
    found = _tuned(make, question.segments(question.recordings, SEGMENTS))
    note = f"re-tuned it gains {found.gain:.1f} nats on what was held out"
    if found.gain <= LEAST:
        return unnamed("no_mismatch", note)
    return farthest(found.moves, note)


def _tuned(make: Callable[[int], EnvBase], segments: Segments) -> Tuned:
    """Fits all parameters of a simulator to segments."""
    simulation = Simulation(make)
    library = Library([], getattr(make(1), "declared", {}))
    problem = Problem(simulation, segments, noise_model(simulation, segments), library)
    [null] = fitted(problem, [library.hypothesis(())], 1)  # with the clock at its best
    problem, best = fitted_to(problem, ROUNDS, ITERATIONS, DEFAULTS.expected_left)
    typical = float(best.square.median()) / problem.noise.dimension
    problem = replace(problem, dispersion=max(1.0, typical))
    group = blocks(segments)
    better, worse = cross_validated(problem, [best, null], group)
    won = advantage(problem.noise, problem.dispersion, better, worse)
    spread = better.covariance.diagonal().clamp_min(0.0).sqrt()
    numbers = zip(best.coordinates, best.vector.tolist(), spread.tolist(), strict=True)
    moves = [Move(c.parameter, z, sd) for c, z, sd in numbers if c.effect]
    return Tuned(moves, won)


def _as_given(question: Asked, simulation: Simulation) -> dict[str, Any]:
    """Whether a simulator without parameters is as right as it is where it counts as right."""
    off, error = _misfit(simulation, question.segments(question.recordings))
    usual = 1.0  # noise
    if question.baseline:
        usual, other = _misfit(simulation, question.segments(question.baseline))
        error = math.hypot(error, other)
    allowed = max(NOTHING, CERTAIN * error) if math.isfinite(error) else NOTHING
    note = (
        f"there are no parameters to tune; misfit {off:.3f}, {usual:.3f} is usual and up to "
        f"{allowed:.3f} more is chance"
    )
    return unnamed("no_mismatch" if off - usual <= allowed else "cannot_tell", note)


def _misfit(simulation: Simulation, segments: Segments) -> tuple[float, float]:
    """Mean standardised residual, and its standard error over blocks."""
    residuals = simulation.residuals(segments)
    return mean_of_blocks(roots(noise_model(simulation, segments), residuals)[0], blocks(segments))


CLEAR = 0.05  # of the noise, by which rollouts must come closer on what was held out,
CERTAINLY_BETTER = 3.0  # and standard errors of that over the blocks of the drives


def black_box(seen: Path) -> dict[str, Any]:
    """Says that something is missing where a network helps on what it was not trained on.

    A network learns the acceleration that the engine's steps lack, on one half of the drives, and
    rollouts of the other half are compared with and without it. What counts is the mean root of
    the whitened square residual, 1 being noise. There is no name, hence no confidence.

    Baseline drives are used as the diagnosis uses them: the simulator is corrected by a small
    network first.
    """
    question = open_question(seen)
    simulation = question.corrected
    segments = question.segments(question.recordings)
    before, after = misfits(simulation, segments)
    gain, spread = mean_of_blocks(before - after, blocks(segments))
    note = (
        f"held-out misfit {float(before.mean()):.3f}, with a network {float(after.mean()):.3f}; "
        f"{gain:.3f} less by block, standard error {spread:.3f}"
    )
    clear = gain > max(CLEAR, CERTAINLY_BETTER * spread)
    return unnamed("unknown_physics" if clear else "no_mismatch", note)


def misfits(simulation: Simulation, segments: Segments) -> tuple[Tensor, Tensor]:
    """|W e| / sqrt(D) of segments [N], as given and with a network that has not seen them.

    Raises:
        ValueError: The drives are too short to hold anything out.
    """
    fold = segment_folds(segments)
    if not bool(fold.any()):
        raise ValueError(f"one drive of less than {2 * BLOCK:g} s: nothing is left to judge on")
    inputs, lacking = lacking_acceleration(simulation, segments)
    residual = simulation.residuals(segments)[0]
    mended = residual.clone()
    for number in fold.unique():
        aside = fold == number
        network = trained(inputs[~aside], lacking[~aside], seed=0)
        effect = ResidualAcceleration(model=network, strength=1.0)
        helped = replace(simulation, standing=(*simulation.standing, effect))
        mended[aside] = helped.residuals(segments[aside])[0]
    before, after = roots(noise_model(simulation, segments), torch.stack([residual, mended]))
    return before, after
