"""The film of the report: the segment that the simulator gets most wrong, as given and repaired."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from buggy_rl.diagnosis.case import Case
from buggy_rl.diagnosis.report.figures import is_repaired, repaired_settings
from buggy_rl.diagnosis.search_result import SearchResult
from buggy_rl.estimation.segments import WARM_UP, Segments, cut_segments
from buggy_rl.viz.film.embedded import embedded_film
from buggy_rl.viz.film.track import Track

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
    """Of the picture."""


def worst_segment(case: Case, found: SearchResult) -> Film | None:
    """The segment whose end the simulator as given misses by most; None where none is long enough.

    Of segments in which a simulator leaves the picture, the film ends there.
    """
    segments = _cut(case)
    if segments is None:
        return None
    motions = _motions(case, found, segments)  # (2 or 3, N, K, 6), measured first
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


def _cut(case: Case) -> Segments | None:
    """Segments of the film's length, fewer and shorter ones of a slow simulator."""
    most = max(FEWEST, round(case.budget.share * MOST))
    for seconds in LENGTHS if case.budget.longer else LENGTHS[-1:]:
        try:
            return cut_segments(case.recordings, seconds, seconds).spread(most)
        except ValueError:
            continue  # no gap-free part is that long
    return None


def _motions(case: Case, found: SearchResult, segments: Segments) -> Tensor:
    """Measured motion, as given and, if there is one, repaired, [2 or 3, N, K, 6], world frame."""
    measured = segments.measured[:, segments.start + 1 :]
    motions = [replace(case.given, every=1).readings(segments)[0]]
    if is_repaired(case, found):
        simulation = replace(case.problem.simulation, every=1)
        motions.append(simulation.readings(segments, repaired_settings(case, found))[0])
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
