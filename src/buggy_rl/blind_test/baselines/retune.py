"""Re-tuning alone: fits the parameters that the simulator declares, and blames what moved most."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torchrl.envs import EnvBase

from buggy_rl.blind_test.baselines.answers import unnamed
from buggy_rl.blind_test.baselines.asked import Asked, asked
from buggy_rl.blind_test.baselines.blockwise import mean_of_blocks, roots
from buggy_rl.blind_test.baselines.moves import Move, farthest
from buggy_rl.diagnosis.search import EAGER
from buggy_rl.diagnosis.selection import NATS
from buggy_rl.estimation.cross_validation import advantage, blocks, evidence
from buggy_rl.estimation.gauss_newton import Fitted, Fitter
from buggy_rl.estimation.hypothesis import OWN, Library
from buggy_rl.estimation.misfit import NOTHING
from buggy_rl.estimation.noise_model import likelihood
from buggy_rl.estimation.rollout import Player
from buggy_rl.estimation.segments import Stretches

STRETCHES = 24  # of a second, spread evenly: a simulator declares up to 43 parameters
CERTAIN = 3.0  # standard errors of a misfit, within which it is as usual
ROUNDS, ITERATIONS = 2, 2  # of the fit: between them it learns how much a nat counts


@dataclass(frozen=True)
class Tuned:
    """A simulator whose parameters were all fitted to some drives."""

    moves: list[Move]
    gain: float
    """On what was held out, over the simulator as it was [nats]."""

    @property
    def values(self) -> dict[str, float]:
        """Of all parameters."""
        return {m.parameter.name: float(m.parameter.value_at(m.place)) for m in self.moves}


def retune(seen: Path) -> dict[str, Any]:
    """Names the parameter that moved most, in units of its size: see `farthest`.

    Every parameter that the simulator declares is fitted to rollouts of a second, about what it
    is, also where the question keeps them from the diagnosis. Where that does not help on what was
    held out, nothing is named. With baseline drives the parameters are fitted to those first, and
    what counts is how they move from there. The confidence is the share of the way that all
    parameters went.

    A simulator that declares nothing cannot be re-tuned: the answer is `no_mismatch` where it
    foretells the drives, `cannot_tell` where it does not.
    """
    question = asked(seen)
    make = question.maker()
    if not getattr(make(1), "declared", {}):
        return _as_given(question, Player(make))
    if question.baseline:
        make = question.maker(tuned(make, question.cut(question.baseline, STRETCHES)).values)
    found = tuned(make, question.cut(question.recordings, STRETCHES))
    note = f"re-tuned it gains {found.gain:.1f} nats on what was held out"
    if found.gain <= NATS:
        return unnamed("no_mismatch", note)
    return farthest(found.moves, note)


def tuned(make: Callable[[int], EnvBase], cut: Stretches) -> Tuned:
    """Fits all parameters of a simulator to stretches."""
    player = Player(make)
    library = Library([], getattr(make(1), "declared", {}))
    fitter = Fitter(player, cut, likelihood(player, cut), library)
    null = fitter.fit([fitter.start(())], 1)[0]  # with the clock at its best
    best = fitter.start([OWN + name for name in library.parameters])
    best = fitter.fit([best], 0)[0]
    for _ in range(ROUNDS):
        fitter.temper = max(1.0, EAGER * _typical(fitter, best))
        best = fitter.fit([best], ITERATIONS)[0]
    fitter.temper = max(1.0, _typical(fitter, best))
    group = blocks(cut)
    better, worse = (evidence(fitter, fitted, group) for fitted in (best, null))
    won = advantage(fitter.likelihood, fitter.temper, better, worse, group)
    spread = better.covariance.diagonal().clamp_min(0.0).sqrt()
    places = zip(best.unknowns, best.place.tolist(), spread.tolist(), strict=True)
    moves = [Move(u.parameter, z, sd) for u, z, sd in places if u.cause]
    return Tuned(moves, won.won - won.lost)


def _typical(fitter: Fitter, fitted: Fitted) -> float:
    return float(fitted.square.median()) / fitter.likelihood.readings


def _as_given(question: Asked, player: Player) -> dict[str, Any]:
    """Whether a simulator without parameters is as right as it is where it counts as right."""
    off, error = _misfit(player, question.cut(question.recordings))
    usual = 1.0  # noise
    if question.baseline:
        usual, other = _misfit(player, question.cut(question.baseline))
        error = math.hypot(error, other)
    allowed = max(NOTHING, CERTAIN * error) if math.isfinite(error) else NOTHING
    note = (
        f"there are no parameters to tune; misfit {off:.3f}, {usual:.3f} is usual and up to "
        f"{allowed:.3f} more is chance"
    )
    return unnamed("no_mismatch" if off - usual <= allowed else "cannot_tell", note)


def _misfit(player: Player, cut: Stretches) -> tuple[float, float]:
    """Size of whitened gaps over that of noise, and its standard error."""
    return mean_of_blocks(roots(likelihood(player, cut), player.play(cut, {}))[0], blocks(cut))
