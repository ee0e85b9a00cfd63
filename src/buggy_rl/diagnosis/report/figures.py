"""What the report draws: replayed rollout segments, and errors by position and situation."""

from dataclasses import replace

import torch

from buggy_rl.diagnosis.case import Case
from buggy_rl.diagnosis.localisation import charged, features
from buggy_rl.diagnosis.search_result import SearchResult
from buggy_rl.estimation.misfit import CAP
from buggy_rl.estimation.rollout import AS_GIVEN, Settings, Simulation
from buggy_rl.estimation.segments import WARM_UP, Segments
from buggy_rl.viz.errors import InstantErrors
from buggy_rl.viz.replays import Replay

TELLING = 2  # segments on which the hypothesis changes most; one more is the median one


def is_repaired(case: Case, found: SearchResult) -> bool:
    """Whether there is a repaired simulator."""
    return bool(found.described.effects) or case.retuned_from is not None


def repaired_settings(case: Case, found: SearchResult) -> Settings:
    """Numbers of the repaired simulator."""
    fit = found.described.fit
    return case.problem.library.settings([(fit, fit.vector)])


def left(case: Case, found: SearchResult) -> tuple[Simulation, Settings]:
    """The simulator whose errors are left: the repaired one, or else as given."""
    if is_repaired(case, found):
        return case.problem.simulation, repaired_settings(case, found)
    return case.given, AS_GIVEN


def errors(case: Case, found: SearchResult) -> InstantErrors:
    """Of the repaired simulator, or else as given, on all segments, by `localisation.charged`."""
    simulation, settings = left(case, found)
    change, instants = charged(simulation, case.problem.segments, case.problem.noise.sd, settings)
    size = (change.square().mean(-1) / 2).sqrt()  # a difference of two readings has twice the noise
    seen = features(case.problem.segments, instants)
    columns = {n: seen[n].flatten().numpy() for n in ("x", "y", "vx", "steering")}
    return InstantErrors(size=size.flatten().numpy(), **columns)


def replays(case: Case, found: SearchResult) -> list[Replay]:
    """Chosen segments, rolled out with the simulator as given and with the repaired one."""
    chosen, problem = _chosen(case, found), case.problem
    segments = problem.segments[torch.tensor([row for row, _ in chosen])]
    residuals = [replace(case.given, every=1).residuals(segments)]
    if is_repaired(case, found):
        simulation = replace(problem.simulation, every=1)
        residuals.append(simulation.residuals(segments, repaired_settings(case, found)))
    measured = segments.motion_from_start  # (n, K, 6)
    read = measured + torch.cat(residuals)  # (1 or 2, n, K, 6)
    return [
        Replay(
            recording=case.names[int(segments.recording[i])],
            begin=float(segments.elapsed[i]) + WARM_UP,
            why=why,
            time=(torch.arange(1, segments.horizon + 1) * segments.dt).numpy(),
            measured=measured[i].numpy(),
            simulated=read[0, i].numpy(),
            repaired=read[1, i].numpy() if len(read) > 1 else None,
            action=segments.action[i, segments.start + 1 :].numpy(),
        )
        for i, (_, why) in enumerate(chosen)
    ]


def _chosen(case: Case, found: SearchResult) -> list[tuple[int, str]]:
    """Rows of the segments with why: those that change most, apart in time, and the median one."""
    before, after = found.null.held_out, found.described.held_out
    if found.described.effects:
        size, why = before.clamp_max(CAP) - after.clamp_max(CAP), "largest improvement"
    else:
        # Rollouts of a spinning car diverge whatever the simulator: they come last.
        size, why = torch.where(before < CAP, before, -before), "largest residual"
    median = int((before - before.median()).abs().argmin())
    rows: list[int] = []
    for row in size.argsort(descending=True).tolist():
        apart = all(_apart(case.problem.segments, row, other) for other in (*rows, median))
        if apart and len(rows) < TELLING:
            rows.append(row)
    return [*((row, why) for row in rows), (median, "median residual")]


def _apart(segments: Segments, one: int, other: int) -> bool:
    """Whether two segments do not touch."""
    between = abs(int(segments.row[one]) - int(segments.row[other]))
    same = int(segments.recording[one]) == int(segments.recording[other])
    return not same or between > 2 * segments.horizon
