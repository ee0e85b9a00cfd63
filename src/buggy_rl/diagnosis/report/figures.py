"""What the report draws: replayed rollout segments, and errors by position and situation."""

from dataclasses import dataclass, replace

import torch
from tensordict import TensorDict
from torch import Tensor

from buggy_rl.core import keys
from buggy_rl.core.longitudinal import declared_by
from buggy_rl.diagnosis.answer.answer import Answer
from buggy_rl.diagnosis.answer.manoeuvres import MANOEUVRES
from buggy_rl.diagnosis.repair.proof import Repair
from buggy_rl.diagnosis.report import wording
from buggy_rl.diagnosis.residuals import charged, drive_features
from buggy_rl.diagnosis.run.case import DiagnosisCase
from buggy_rl.diagnosis.search.result import SearchResult
from buggy_rl.estimation.evidence import CAP
from buggy_rl.estimation.rollout import sensed
from buggy_rl.estimation.segments import WARM_UP, Segments, cut_segments
from buggy_rl.figures.drives import ManoeuvrePlan, ReplayedSegment
from buggy_rl.figures.models import InstantErrors
from buggy_rl.visual.film.film import embedded_film
from buggy_rl.visual.film.track import Track

TELLING = 2  # segments on which the hypothesis changes most; one more is the median one


def errors(case: DiagnosisCase, repair: Repair) -> InstantErrors:
    """Errors of the repaired simulator, or else as given, on all segments, by `charged`."""
    simulation, settings = repair.simulation(case)
    change, instants = charged(simulation, case.problem.segments, case.problem.noise.sd, settings)
    size = (change.square().mean(-1) / 2).sqrt()  # a difference of two readings has twice the noise
    seen = drive_features(case.problem.segments, instants)
    columns = {n: seen[n].flatten().numpy() for n in ("x", "y", "vx", "steering")}
    return InstantErrors(size=size.flatten().numpy(), **columns)


def replays(case: DiagnosisCase, found: SearchResult, repair: Repair) -> list[ReplayedSegment]:
    """Chosen segments, rolled out with the simulator as given and with the repaired one."""
    chosen, problem = _chosen(case, found), case.problem
    segments = problem.segments[torch.tensor([row for row, _ in chosen])]
    residuals = [replace(case.given, every=1).residuals(segments)]
    if repair.is_one:
        simulation, settings = repair.simulation(case)
        residuals.append(replace(simulation, every=1).residuals(segments, settings))
    measured = segments.motion_from_start  # (n, K, 6)
    read = measured + torch.cat(residuals)  # (1 or 2, n, K, 6)
    return [
        ReplayedSegment(
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


def _chosen(case: DiagnosisCase, found: SearchResult) -> list[tuple[int, str]]:
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


def manoeuvre_plan(
    case: DiagnosisCase, found: SearchResult, answer: Answer
) -> ManoeuvrePlan | None:
    """The manoeuvre that is suggested, and its prediction by each hypothesis; None without one."""
    known = {m.name: m for m in MANOEUVRES}
    if not (answer.suggest and answer.manoeuvres) or answer.manoeuvres[0].manoeuvre not in known:
        return None
    rate, problem = answer.manoeuvres[0], case.problem
    simulation, dt = problem.simulation, problem.segments.dt
    between = [effects for effects in rate.between if effects in found.tried]
    fits = [found.tried[effects].fit for effects in between]
    action = known[rate.manoeuvre].actions(dt, declared_by(simulation.make(1)).rest)
    rest = torch.zeros(len(fits), 3)
    start = TensorDict({keys.POSE: rest, keys.VELOCITY: rest.clone()}, [len(fits)])
    settings = problem.library.settings([(fit, fit.vector) for fit in fits])
    states = simulation.drive(action.repeat(len(fits), 1, 1), settings, start)
    read = torch.stack([sensed(state) for state in states], 1).double().numpy()  # (H, T, 6)
    names = [
        " + ".join(map(wording.effect, effects)) or "nothing is missing" for effects in between
    ]
    return ManoeuvrePlan(
        time=(dt * torch.arange(len(action))).double().numpy(),
        action=action.numpy(),
        predicted=dict(zip(names, read, strict=True)),
    )


LENGTHS = (2.0, 1.0)  # [s] of the film, as long as a gap-free part of the recordings is
MOST, FEWEST = 10, 3  # segments of which the worst is chosen
FAR = 1.0  # [m] of the buggy, from the measured car, at which a simulated one has left the picture
SHORTEST = 0.3  # [s]
NAMES = ("measured", "as given", "repaired")


@dataclass(frozen=True)
class Film:
    """A picture that moves, and what it shows."""

    caption: str
    uri: str
    """URI of the picture."""


def worst_segment(case: DiagnosisCase, repair: Repair) -> Film | None:
    """The segment whose end the simulator as given misses by most; None where none is long enough.

    Of segments in which a simulator leaves the picture, the film ends there.
    """
    segments = _cut(case)
    if segments is None:
        return None
    motions = _motions(case, repair, segments)  # (2 or 3, N, K, 6), measured first
    far = FAR * case.problem.library.similarity.length
    off = (motions[1:, ..., :2] - motions[0, ..., :2]).norm(dim=-1)  # (1 or 2, N, K)
    inside = (off < far) & motions[1:].isfinite().all(-1)
    lasts = inside.all(0).int().cumprod(-1).sum(-1)  # (N,) rows until one leaves
    long_enough = lasts * segments.dt >= SHORTEST
    if not bool(long_enough.any()):
        return None
    last = (lasts - 1).clamp_min(0)
    missed = off[0].gather(-1, last.unsqueeze(-1)).squeeze(-1)
    whole = lasts == segments.horizon  # before those in which a simulated car leaves the picture
    row = int((torch.where(long_enough, missed, -1.0) + far * whole).argmax())
    tracks = _tracks(motions[:, row, : int(lasts[row])], segments, row)
    begin = float(segments.elapsed[row]) + WARM_UP
    ends = off[:, row, int(last[row])]
    said = " and ".join(
        f"{1000 * float(end):.0f} mm {name}" for end, name in zip(ends, NAMES[1:], strict=False)
    )
    caption = (
        f"{case.names[int(segments.recording[row])]}, {begin:.1f} to "
        f"{begin + tracks[0].duration:.1f} s, at half speed: the same commands from the same "
        f"state; at the end off by {said}."
    )
    return Film(caption, embedded_film(tracks, case.problem.library.similarity.length))


def _cut(case: DiagnosisCase) -> Segments | None:
    """Segments of the film's length, fewer and shorter ones of a slow simulator."""
    most = max(FEWEST, round(case.budget.share * MOST))
    for seconds in LENGTHS if case.budget.longer else LENGTHS[-1:]:
        try:
            return cut_segments(case.recordings, seconds, seconds).spread(most)
        except ValueError:
            continue  # no gap-free part is that long
    return None


def _motions(case: DiagnosisCase, repair: Repair, segments: Segments) -> Tensor:
    """Measured motion, as given and, if there is one, repaired, [2 or 3, N, K, 6], world frame."""
    measured = segments.measured[:, segments.start + 1 :]
    motions = [replace(case.given, every=1).readings(segments)[0]]
    if repair.is_one:
        simulation, settings = repair.simulation(case)
        motions.append(replace(simulation, every=1).readings(segments, settings)[0])
    return torch.stack([measured, *motions])


def _tracks(motions: Tensor, segments: Segments, row: int) -> list[Track]:
    """Tracks of motions [2 or 3, K, 6] of a segment."""
    count = motions.shape[1]
    time = (segments.dt * torch.arange(count)).double().numpy()
    action = segments.action[row, segments.start + 1 :][:count].double().numpy()
    each = [motion.double().numpy() for motion in motions]
    return [
        Track(name, time, motion[:, :3], motion[:, 3:], action)
        for name, motion in zip(NAMES, each, strict=False)
    ]
