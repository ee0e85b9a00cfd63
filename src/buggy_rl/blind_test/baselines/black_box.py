"""A residual network: it may mend the simulator, and can name nothing."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from buggy_rl.blind_test.baselines.answers import unnamed
from buggy_rl.blind_test.baselines.asked import asked
from buggy_rl.blind_test.baselines.blockwise import mean_of_blocks, roots
from buggy_rl.diagnosis.validation import folds
from buggy_rl.effects.residual import ResidualAcceleration
from buggy_rl.estimation.cross_validation import BLOCK, blocks
from buggy_rl.estimation.noise_model import noise_model
from buggy_rl.estimation.residual_network import lacking_acceleration, trained
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import Segments

CLEAR = 0.05  # of the noise, by which rollouts must come closer on what was held out,
CERTAIN = 3.0  # and standard errors of that over the blocks of the drives


def black_box(seen: Path) -> dict[str, Any]:
    """Says that something is missing where a network helps on what it was not trained on.

    A network learns the acceleration that the engine's steps lack, on one half of the drives, and
    rollouts of the other half are compared with and without it. What counts is the mean root of
    the whitened square residual, 1 being noise. There is no name, hence no confidence.

    Baseline drives are used as the diagnosis uses them: the simulator is corrected by a small
    network first.
    """
    question = asked(seen)
    simulation = question.corrected
    segments = question.segments(question.recordings)
    before, after = misfits(simulation, segments)
    gain, spread = mean_of_blocks(before - after, blocks(segments))
    note = (
        f"held-out misfit {float(before.mean()):.3f}, with a network {float(after.mean()):.3f}; "
        f"{gain:.3f} less by block, standard error {spread:.3f}"
    )
    clear = gain > max(CLEAR, CERTAIN * spread)
    return unnamed("unknown_physics" if clear else "no_mismatch", note)


def misfits(simulation: Simulation, segments: Segments) -> tuple[Tensor, Tensor]:
    """|W e| / sqrt(D) of segments [N], as given and with a network that has not seen them.

    Raises:
        ValueError: The drives are too short to hold anything out.
    """
    fold = folds(segments)
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
