"""Whether a simulator's integration step is fine enough for drives, before physics is missed.

What a coarse step makes of a simulator's equations passes for other tyres. Solving them with half
the step tells one from the other: verification comes before validation (Oberkampf & Roy 2010,
Verification and Validation in Scientific Computing).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from buggy_rl.estimation.misfit import misfit
from buggy_rl.estimation.noise_model import likelihood
from buggy_rl.estimation.rollout import Player
from buggy_rl.estimation.segments import Stretches

CLOSER = 0.1  # times the noise, by which half the step must come closer to the drives
HALVINGS = 3  # at most: each takes twice the time


@dataclass(frozen=True)
class Step:
    """The integration step with which a simulator is looked at."""

    options: dict[str, Any] = field(default_factory=dict)
    """Of the simulator, where it is not the one that it was given with."""
    note: str = ""


def fine_enough(player: Callable[[Mapping[str, Any]], Player], cut: Stretches) -> Step:
    """Halves a simulator's step as long as that brings it closer to the drives.

    A simulator that was fitted with a coarse step is right with it, and keeps it.

    Args:
        player: Into the simulator with further options; none plays into it as it was given.
        cut: Of the drives.
    """
    own = player({})
    finer = _halved(own)
    if not finer:
        return Step()
    weighed = likelihood(own, cut)
    given = weighed.white(own.play(cut, {}))[0].square().mean(-1)
    first = last = misfit(given, given)
    chosen: dict[str, Any] = {}
    for _ in range(HALVINGS):
        half = player(finer)
        off = misfit(weighed.white(half.play(cut, {}))[0].square().mean(-1), given)
        if last - off < CLOSER:
            break
        chosen, last, finer = finer, off, _halved(half)
    if not chosen:
        return Step()
    named = ", ".join(f"{name}={value:g}" for name, value in chosen.items())
    return Step(
        chosen,
        f"the simulator integrates too coarsely for these drives: with {named} in its options it "
        f"is off by {last:.2f} times the noise instead of {first:.2f}; the answer is about that "
        "one, and repaired.yaml has it",
    )


def _halved(player: Player) -> dict[str, Any]:
    """Options with half the step of the simulator that is played into, if it has one."""
    return getattr(player.make(1), "half_step", {})
