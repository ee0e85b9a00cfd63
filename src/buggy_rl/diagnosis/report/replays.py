"""The stretches that tell most: measured, simulated as given, and simulated as repaired."""

from dataclasses import dataclass, replace

import numpy as np
import torch

from buggy_rl.diagnosis.case import Case
from buggy_rl.diagnosis.search import Found
from buggy_rl.estimation.misfit import CAP
from buggy_rl.estimation.segments import WARM_UP, Stretches

TELLING = 2  # stretches on which the explanation shows most; one more is an ordinary one


@dataclass(frozen=True)
class Replay:
    """One stretch, every row; places are seen from where the rollout starts, x ahead, y left."""

    recording: str
    begin: float
    """[s] since the drive began."""
    why: str
    """What it was chosen for."""
    time: np.ndarray
    """[K] s since the start of the rollout."""
    measured: np.ndarray
    """[K, 6] x, y [m], yaw [rad], vx, vy [m/s], yaw_rate [rad/s]."""
    simulated: np.ndarray
    """[K, 6], not finite where the simulator is not."""
    repaired: np.ndarray | None
    """[K, 6]; None where nothing was named."""
    action: np.ndarray
    """[K, 2] throttle and steering."""


def replays(case: Case, found: Found) -> list[Replay]:
    """Plays the chosen stretches again."""
    chosen = _chosen(case, found)
    cut = case.cut[torch.tensor([row for row, _ in chosen])]
    gaps = [replace(case.given, every=1).play(cut, {})]
    if found.best.causes or case.retuned_from is not None:
        row = (found.best.fitted.unknowns, found.best.fitted.place)
        gaps.append(replace(case.player, every=1).play(cut, *case.library.settings([row])))
    gap = torch.cat(gaps)  # (1 or 2, n, K, 6)
    measured = cut.seen_from_start  # (n, K, 6)
    read = measured + gap
    return [
        Replay(
            recording=case.names[int(cut.drive[i])],
            begin=float(cut.elapsed[i]) + WARM_UP * cut.dt,
            why=why,
            time=(torch.arange(1, cut.horizon + 1) * cut.dt).numpy(),
            measured=measured[i].numpy(),
            simulated=read[0, i].numpy(),
            repaired=read[1, i].numpy() if len(read) > 1 else None,
            action=cut.action[i, WARM_UP + 1 :].numpy(),
        )
        for i, (_, why) in enumerate(chosen)
    ]


def _chosen(case: Case, found: Found) -> list[tuple[int, str]]:
    """Rows of the stretches, and why: those it shows on most, far apart, and an ordinary one."""
    before, after = found.null.held_out, found.best.held_out
    if found.best.causes:
        size, why = before.clamp_max(CAP) - after.clamp_max(CAP), "where the repair helps most"
    else:
        # Where a car spins no two rollouts agree: it shows nothing but that.
        size, why = torch.where(before < CAP, before, -before), "where it is furthest off"
    ordinary = int((before - before.median()).abs().argmin())
    rows: list[int] = []
    for row in size.argsort(descending=True).tolist():
        apart = all(_apart(case.cut, row, other) for other in (*rows, ordinary))
        if apart and len(rows) < TELLING:
            rows.append(row)
    return [*((row, why) for row in rows), (ordinary, "an ordinary stretch")]


def _apart(cut: Stretches, one: int, other: int) -> bool:
    """Whether two stretches do not touch."""
    between = abs(int(cut.row[one]) - int(cut.row[other]))
    return int(cut.drive[one]) != int(cut.drive[other]) or between > 2 * cut.horizon
