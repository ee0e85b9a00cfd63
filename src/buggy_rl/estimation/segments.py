"""Rollout segments: about a second of a recording each, with the measured motion before it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor

from buggy_rl.core import keys
from buggy_rl.core.longitudinal import drive_of
from buggy_rl.core.vehicle import CONTROL_PERIOD, rotate
from buggy_rl.recordings import Recording
from buggy_rl.recordings.resampling import filtered, local_parabola
from buggy_rl.recordings.windows import windows

WARM_UP = 0.3  # [s] of measured motion imposed before a rollout: latent states settle
HORIZONS = (0.3, 1.0, 3.0)  # [s] at which rollouts are judged
CHANNELS = ("vx", "vy", "yaw_rate")
LATEST = 0.3  # [s] known beyond a segment's start, for sensors that report late
AHEAD = round(LATEST / CONTROL_PERIOD)  # [rows] of that at the car's own rate
# [s] back from a segment's start: intervals over which the mean square drive is known, for heat
WORKED = (0.0, 3.0, 6.0, 12.0, 24.0, 48.0, 96.0, 192.0, 384.0)
EARLIER = 3.0  # [s] of commands before a segment: play and slow servos remember them
SMOOTHED = 0.15  # [s] of the local parabola; a car's motion bends little within it
LEAST_SMOOTHED = 5  # [rows] of it: three it would follow whatever they are, and show no noise


@dataclass(frozen=True)
class Segments:
    """N segments of L = start + H + 1 rows each; rollouts begin at row `start`."""

    pose: Tensor
    """[N, L, 3] measured; x, y [m], yaw [rad], not wrapped."""
    velocity: Tensor
    """[N, L, 3] measured [m/s, rad/s]."""
    smooth_pose: Tensor
    """[N, L, 3] smoothed; rollouts start from it."""
    smooth_velocity: Tensor
    """[N, L, 3] smoothed."""
    action: Tensor
    """[N, L, 2]"""
    earlier: Tensor
    """[N, E, 2] actions of `EARLIER` before row 0; a recording's first one stands for those before
    it."""
    elapsed: Tensor
    """[N] time since the recording began, at row 0 [s]."""
    session: Tensor
    """[N] time since the first recording of the session began, at row 0 [s]; likewise where the
    stamps do not tell."""
    worked: Tensor
    """[N, B] mean square drive in the intervals `WORKED` before row 0; 0 before the recording."""
    recording: Tensor
    """[N] int, index of the recording."""
    row: Tensor
    """[N] int, row of the recording that is row 0."""
    dt: float
    """[s]"""

    def __len__(self) -> int:
        return len(self.pose)

    @property
    def start(self) -> int:
        """Row at which rollouts begin, after `WARM_UP`."""
        return warm_up_rows(self.dt)

    @property
    def horizon(self) -> int:
        """Rows of a rollout (H)."""
        return self.pose.shape[1] - self.start - 1

    @property
    def measured(self) -> Tensor:
        """[N, L, 6] measured pose and velocity."""
        return torch.cat([self.pose, self.velocity], -1)

    @property
    def motion_from_start(self) -> Tensor:
        """[N, H, 6] measured motion of the rollouts; x, y ahead and left of where they start."""
        first = self.start
        start = self.smooth_pose[:, first : first + 1]
        pose, velocity = self.pose[:, first + 1 :], self.velocity[:, first + 1 :]
        way = pose[..., :2] - start[..., :2]
        position = rotate(way, -start[..., 2].expand(way.shape[:-1]))
        return torch.cat([position, pose[..., 2:] - start[..., 2:], velocity], -1)

    def __getitem__(self, index: Tensor) -> "Segments":
        parts = {n: value[index] for n, value in vars(self).items() if isinstance(value, Tensor)}
        return replace(self, **parts)

    def to(self, device: torch.device | None) -> "Segments":
        """Segments with all tensors on a device; None leaves them where they are."""
        tensors = {n: value for n, value in vars(self).items() if isinstance(value, Tensor)}
        return replace(self, **{n: value.to(device=device) for n, value in tensors.items()})

    def shortened(self, rows: int) -> "Segments":
        """Segments of rollouts of so many rows."""
        length = self.start + rows + 1
        parts = ("pose", "velocity", "smooth_pose", "smooth_velocity", "action")
        return replace(self, **{name: getattr(self, name)[:, :length] for name in parts})

    def windows(self, seconds: float) -> tuple["Segments", Tensor]:
        """Segments of shorter rollouts that cover these, and of which of these [M] each is a part.

        Their heat is that at the start of the longer one.

        Args:
            seconds: Of a rollout; no more than of these.
        """
        rows = min(max(1, round(seconds / self.dt)), self.horizon)
        count = -(-self.horizon // rows)
        firsts = torch.linspace(0, self.horizon - rows, count).round().long().tolist()
        parts = [self._from(first).shortened(rows) for first in firsts]
        return segments_joined(parts), torch.arange(len(self)).repeat(count)

    def _from(self, first: int) -> "Segments":
        """Segments that begin so many rows later."""
        late = ("pose", "velocity", "smooth_pose", "smooth_velocity", "action")
        given = torch.cat([self.earlier, self.action[:, :first]], 1)
        return replace(
            self,
            **{name: getattr(self, name)[:, first:] for name in late},
            earlier=given[:, given.shape[1] - self.earlier.shape[1] :],
            elapsed=self.elapsed + first * self.dt,
            session=self.session + first * self.dt,
            row=self.row + first,
        )

    def length_blocks(self) -> Tensor:
        """[N] A number shared by segments that start within one length of each other."""
        return self.recording * 1_000_000 + self.row // self.pose.shape[1]

    def spread(self, most: int) -> "Segments":
        """Segments spread evenly over the recordings, at most so many of them."""
        if len(self) <= most:
            return self
        return self[torch.linspace(0, len(self) - 1, most).round().long()]


def segments_joined(parts: Sequence[Segments]) -> Segments:
    """Segments of one length and rate, one after another."""
    names = [n for n, value in vars(parts[0]).items() if isinstance(value, Tensor)]
    together: dict[str, Any] = {n: torch.cat([getattr(p, n) for p in parts]) for n in names}
    return replace(parts[0], **together)


def cut_segments(
    recordings: Sequence[Recording], seconds: float, stride: float, smoothing: int = 0
) -> Segments:
    """Cuts recordings into segments; none crosses a gap.

    Args:
        recordings: All with the same control period.
        seconds: Length of a rollout.
        stride: From the start of one segment to the start of the next [s].
        smoothing: Rows of the local parabola; 0 for those of `SMOOTHED`.

    Raises:
        ValueError: No recording has a gap-free segment of that length.
    """
    dt = recordings[0].dt
    length, rows = segment_rows(seconds, dt), max(1, round(stride / dt))
    smoothing = smoothing or smoothing_rows(dt)
    measured = windows(recordings, length, rows)
    smooth = windows([_smoothed(r, smoothing) for r in recordings], length, rows)
    first, index = measured[keys.ROW][:, 0], measured[keys.RECORDING][:, 0]
    begun = torch.stack([recording.data[keys.TIME][0, 0] for recording in recordings])
    since_first = torch.tensor([r.since_first for r in recordings], dtype=torch.float64)
    starts = list(zip(index.tolist(), first.tolist(), strict=True))
    times = torch.stack([recordings[i].data[keys.TIME][row, 0] for i, row in starts])
    return Segments(
        pose=measured[keys.POSE],
        velocity=measured[keys.VELOCITY],
        smooth_pose=smooth[keys.POSE],
        smooth_velocity=smooth[keys.VELOCITY],
        action=measured[keys.ACTION],
        earlier=torch.stack([_earlier(recordings[i], row, dt) for i, row in starts]),
        elapsed=(times - begun[index]).float(),
        session=(times - begun[index] + since_first[index]).float(),
        worked=torch.stack([_worked(recordings[i], row, dt) for i, row in starts]),
        recording=index,
        row=first,
        dt=dt,
    )


def warm_up_rows(dt: float) -> int:
    """Rows of `WARM_UP`."""
    return round(WARM_UP / dt)


def segment_rows(seconds: float, dt: float) -> int:
    """Rows of a segment whose rollout takes so many seconds, its warm-up included."""
    return warm_up_rows(dt) + round(seconds / dt) + 1


def smoothing_rows(dt: float) -> int:
    """Rows of the local parabola, an odd number."""
    return max(LEAST_SMOOTHED, 2 * round((SMOOTHED / dt - 1) / 2) + 1)


def _earlier(recording: Recording, row: int, dt: float) -> Tensor:
    rows = round(EARLIER / dt)
    given = recording.data[keys.ACTION][max(0, row - rows) : row + 1]
    return torch.cat([given[:1].expand(rows + 1 - len(given), -1), given])[:-1]


def _worked(recording: Recording, row: int, dt: float) -> Tensor:
    """[B] means of the drive's square in the intervals of `WORKED` before a row."""
    drive = drive_of(recording.data[keys.ACTION][:row, 0].double(), recording.command.rest)
    total = torch.cat([torch.zeros(1, dtype=torch.float64), drive.square().cumsum(0)])
    back = [min(round(edge / dt), row) for edge in WORKED]
    sums = [total[row - newer] - total[row - older] for newer, older in pairwise(back)]
    spans = torch.tensor([round((b - a) / dt) for a, b in pairwise(WORKED)])
    return (torch.stack(sums) / spans).float()


def _smoothed(recording: Recording, rows: int) -> Recording:
    smooth = filtered(recording, rows, local_parabola)
    data = smooth.data
    for segment in data[keys.SEGMENT].unique():
        inside = data[keys.SEGMENT] == segment
        data[keys.POSE][inside] = local_parabola(data[keys.POSE][inside], rows)
    return Recording(smooth.name, TensorDict(data.to_dict(), data.batch_size), smooth.dt)
