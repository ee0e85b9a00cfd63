"""Whether a simulator's integration step is fine enough for the recordings.

The error of a coarse step resembles other tyres. Solving the equations with half the step tells
one from the other: verification comes before validation (Oberkampf & Roy 2010,
Verification and Validation in Scientific Computing).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from buggy_rl.estimation.evidence import misfit
from buggy_rl.estimation.noise_model import noise_model
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import Segments

HALVINGS = 3  # at most; each takes twice the time


@dataclass(frozen=True)
class IntegrationStep:
    """The integration step with which a simulator is looked at."""

    options: dict[str, Any] = field(default_factory=dict)
    """Options of the simulator, where its step is not the one that it was given with."""
    note: str = ""


def fine_enough(
    simulation: Callable[[Mapping[str, Any]], Simulation], segments: Segments, least_gain: float
) -> IntegrationStep:
    """Halves a simulator's step as long as that brings it closer to the recordings.

    A simulator that was fitted with a coarse step is right with it, and keeps it.

    Args:
        simulation: Of the simulator with further options; with none, as it was given.
        segments: Of the recordings.
        least_gain: By which half the step must come closer [noise].
    """
    own = simulation({})
    finer = _halved(own)
    if not finer:
        return IntegrationStep()
    noise = noise_model(own, segments)
    given = noise.whiten(own.residuals(segments))[0].square().mean(-1)
    first = last = misfit(given, given)
    chosen: dict[str, Any] = {}
    for _ in range(HALVINGS):
        half = simulation(finer)
        off = misfit(noise.whiten(half.residuals(segments))[0].square().mean(-1), given)
        if last - off < least_gain:
            break
        chosen, last, finer = finer, off, _halved(half)
    if not chosen:
        return IntegrationStep()
    named = ", ".join(f"{name}={value:g}" for name, value in chosen.items())
    return IntegrationStep(
        chosen,
        f"the simulator integrates too coarsely for these drives: with {named} in its options it "
        f"is off by {last:.2f} times the noise instead of {first:.2f}; the answer is about that "
        "one, and repaired.yaml has it",
    )


def _halved(simulation: Simulation) -> dict[str, Any]:
    """Options with half the step of a simulator, if it has one."""
    return getattr(simulation.make(1), "half_step", {})
