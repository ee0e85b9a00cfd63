"""Measures a simulator and plans a diagnosis with it."""

import time
from collections.abc import Sequence

from buggy_rl.diagnosis.case import segments_of
from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.diagnosis.limits import LIMITS
from buggy_rl.diagnosis.plan import Plan, Question, planned, shortest
from buggy_rl.estimation.cost import measured_cost
from buggy_rl.estimation.hypothesis import Library
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import HORIZONS, cut_segments
from buggy_rl.recordings import Recording

MEASURED = 0.1  # [s] of a rollout by which time is measured, beside its warm-up


def plan_of(
    config: DiagnosisConfig,
    simulation: Simulation,
    library: Library,
    recordings: Sequence[Recording],
    baseline: Sequence[Recording] = (),
    begun: float | None = None,
    short: str = "",
) -> Plan:
    """The plan of a diagnosis in the time that it may take.

    Args:
        config: The question.
        simulation: Of the simulator; its workers learn from it what is worth dividing.
        library: Effects to choose from.
        recordings: To be compared.
        baseline: Recordings on which the simulator was right.
        begun: When that time began (`time.perf_counter`); None for now.
        short: Why the search is as short as it can be, where `minutes` limits it at all.
    """
    segments = segments_of(recordings, config)
    cost = measured_cost(
        simulation, segments.shortened(round(MEASURED / segments.dt)), library.effects
    )
    simulation.workers.least = cost.least_share
    question = Question(
        segments=len(segments),
        rows=segments.pose.shape[1] - 1,
        trials=sum(len(library.trials(name, segments, (1.0,))) for name in library.names),
        baseline=len(segments_of(baseline, config)) if baseline else 0,
        longer=_longer(recordings),
        limits=sum({limit.effect, limit.becomes} <= {*library.effects} for limit in LIMITS),
    )
    if short and config.minutes:
        return shortest(question, cost, short)
    spent = 0.0 if begun is None else time.perf_counter() - begun
    return planned(question, cost, config.minutes, spent)


def _longer(recordings: Sequence[Recording]) -> int:
    """Segments of the longest horizon."""
    try:
        return len(cut_segments(recordings, HORIZONS[-1], HORIZONS[-1]))
    except ValueError:  # no gap-free part is that long
        return 0
