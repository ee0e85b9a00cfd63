"""Recordings of a question, cut into segments once."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.diagnosis.run.budget import Budget
from buggy_rl.estimation.segments import HORIZONS, Segments, cut_segments
from buggy_rl.recordings import Recording


@dataclass(frozen=True, eq=False)
class Drives:
    """What a simulator should have predicted, and what it predicts rightly."""

    recordings: Sequence[Recording]
    segments: Segments
    """Segments of the recordings, as many as are asked for, spread evenly."""
    longer: Mapping[float, Segments] = field(default_factory=dict)
    """Horizon [s] beyond that of `segments` -> all segments of that length."""
    baseline: Segments | None = None
    """Segments of recordings on which the simulator counts as right, likewise spread; None without
    any."""

    @classmethod
    def cut(
        cls,
        config: DiagnosisConfig,
        recordings: Sequence[Recording],
        baseline: Sequence[Recording] = (),
    ) -> "Drives":
        """Cuts recordings as a question asks for it.

        Raises:
            ValueError: They have no gap-free segment of that length.
        """
        return cls(
            recordings,
            segments_of(recordings, config),
            longer_segments(recordings, config.seconds),
            segments_of(baseline, config) if baseline else None,
        )

    def within(self, budget: Budget) -> "Drives":
        """The drives with as many segments as a budget has."""
        kept, before = self.segments, self.baseline
        return replace(
            self,
            segments=kept.spread(budget.segments(len(kept))),
            baseline=None if before is None else before.spread(budget.segments(len(before))),
        )


def segments_of(recordings: Sequence[Recording], config: DiagnosisConfig) -> Segments:
    """Cuts as many segments as are asked for, spread evenly over recordings."""
    return cut_segments(recordings, config.seconds, config.seconds).spread(config.stretches)


def longer_segments(recordings: Sequence[Recording], seconds: float) -> dict[float, Segments]:
    """Horizon [s] beyond `seconds` -> segments; none where no gap-free part is that long."""
    found = {}
    for horizon in HORIZONS:
        if horizon > seconds:
            try:
                found[horizon] = cut_segments(recordings, horizon, horizon)
            except ValueError:
                continue
    return found
