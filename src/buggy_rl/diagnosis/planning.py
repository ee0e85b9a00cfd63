"""Measures a simulator and plans a diagnosis with it."""

import time

from buggy_rl.diagnosis.drives import Drives
from buggy_rl.diagnosis.limits import LIMITS
from buggy_rl.diagnosis.plan import Plan, Question, planned, shortest
from buggy_rl.estimation.cost import measured_cost
from buggy_rl.estimation.hypothesis import Library
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import HORIZONS

MEASURED = 0.1  # [s] of a rollout by which time is measured, beside its warm-up


def plan_of(
    simulation: Simulation,
    library: Library,
    drives: Drives,
    minutes: float,
    begun: float | None = None,
    short: str = "",
) -> Plan:
    """The plan of a diagnosis in the time that it may take.

    Args:
        simulation: Of the simulator; its workers learn from it what is worth dividing.
        library: Effects to choose from.
        drives: To be compared.
        minutes: That the diagnosis may take.
        begun: When that time began (`time.perf_counter`); None for now.
        short: Why the search is as short as it can be, where `minutes` limits it at all.
    """
    segments = drives.segments
    cost = measured_cost(
        simulation, segments.shortened(round(MEASURED / segments.dt)), library.effects
    )
    simulation.workers.least = cost.least_share
    question = Question(
        segments=len(segments),
        rows=segments.pose.shape[1] - 1,
        trials=sum(len(library.trials(name, segments, (1.0,))) for name in library.names),
        baseline=0 if drives.baseline is None else len(drives.baseline),
        longer=len(drives.longer.get(HORIZONS[-1], ())),
        limits=sum({limit.effect, limit.becomes} <= {*library.effects} for limit in LIMITS),
    )
    if short and minutes:
        return shortest(question, cost, short)
    spent = 0.0 if begun is None else time.perf_counter() - begun
    return planned(question, cost, minutes, spent)
