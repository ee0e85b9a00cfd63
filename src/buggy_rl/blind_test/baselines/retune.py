"""Re-tuning alone: fits the parameters that the simulator declares, and blames what moved most."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from torchrl.envs import EnvBase

from buggy_rl.blind_test.baselines.answers import unnamed
from buggy_rl.blind_test.baselines.asked import Asked, asked
from buggy_rl.blind_test.baselines.blockwise import mean_of_blocks, roots
from buggy_rl.blind_test.baselines.moves import Move, farthest
from buggy_rl.diagnosis.config import DEFAULTS
from buggy_rl.diagnosis.retuning import tuned as fitted_to
from buggy_rl.estimation.cross_validation import advantage, blocks, cross_validated
from buggy_rl.estimation.gauss_newton import Problem, fitted
from buggy_rl.estimation.hypothesis import Library
from buggy_rl.estimation.misfit import NOTHING
from buggy_rl.estimation.noise_model import noise_model
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import Segments

SEGMENTS = 24  # of a second, spread evenly: a simulator declares up to 43 parameters
CERTAIN = 3.0  # [standard errors] within which a misfit is that of the baseline
LEAST = 6.0  # [nats] gained on what was held out, above which something is wrong; chosen
ROUNDS, ITERATIONS = 2, 2  # of the fit: between rounds the dispersion is estimated anew


@dataclass(frozen=True)
class Tuned:
    """A simulator whose parameters were all fitted to some recordings."""

    moves: list[Move]
    gain: float
    """On what was held out, over the simulator as it was [nats]."""

    @property
    def values(self) -> dict[str, float]:
        """Of all parameters."""
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
    question = asked(seen)
    make = question.maker()
    if not getattr(make(1), "declared", {}):
        return _as_given(question, Simulation(make))
    if question.baseline:
        before = question.segments(question.baseline, SEGMENTS)
        make = question.maker(tuned(make, before).values)
    found = tuned(make, question.segments(question.recordings, SEGMENTS))
    note = f"re-tuned it gains {found.gain:.1f} nats on what was held out"
    if found.gain <= LEAST:
        return unnamed("no_mismatch", note)
    return farthest(found.moves, note)


def tuned(make: Callable[[int], EnvBase], segments: Segments) -> Tuned:
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
