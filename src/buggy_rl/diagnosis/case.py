"""A question cut into what is computed with."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.estimation.hypothesis import Library
from buggy_rl.estimation.misfit import Usual
from buggy_rl.estimation.noise_model import Likelihood, likelihood
from buggy_rl.estimation.rollout import Player
from buggy_rl.estimation.segments import Stretches, stretches
from buggy_rl.recordings import Recording


@dataclass
class Case:
    """Drives and simulator of a question, ready to be compared."""

    player: Player
    cut: Stretches
    likelihood: Likelihood
    library: Library
    names: list[str]
    recordings: Sequence[Recording]
    usual: Usual = field(default_factory=Usual)
    """Excess over the noise that is no sign of anything."""
    retuned_from: Player | None = None
    """Plays into the simulator as it was given, where it has been re-tuned since."""

    @property
    def given(self) -> Player:
        """Plays into the simulator as it was given."""
        return self.retuned_from or self.player

    @property
    def as_given(self) -> Library:
        """Causes, with what the simulator as given has of each."""
        if self.retuned_from is None:
            return self.library
        declared = getattr(self.retuned_from.make(1), "declared", {})
        return Library(self.library.effects, declared)


def prepared(
    player: Player,
    recordings: Sequence[Recording],
    library: Library,
    config: DiagnosisConfig,
    extra: Tensor | None = None,
) -> Case:
    """Cuts drives and weighs their noise."""
    cut = stretches_of(recordings, config)
    weighed = likelihood(player, cut, extra=extra)
    return Case(player, cut, weighed, library, [r.name for r in recordings], recordings)


def stretches_of(recordings: Sequence[Recording], config: DiagnosisConfig) -> Stretches:
    """As many stretches of drives as are asked for, spread evenly."""
    cut = stretches(recordings, config.seconds, config.seconds)
    if len(cut) > config.stretches:
        rows = torch.linspace(0, len(cut) - 1, config.stretches).round().long()
        cut = cut[rows]
    return cut
