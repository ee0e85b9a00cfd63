"""Rollout segments: about a second of a recording each, with the measured motion before it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from tensordict import TensorDict
from torch import Tensor

from buggy_rl import keys
from buggy_rl.recordings import Recording
from buggy_rl.recordings.filters import filtered, local_parabola
from buggy_rl.recordings.windows import windows
from buggy_rl.vehicle import rotate

WARM_UP = 30  # [rows] 0.3 s of measured motion imposed before a rollout: latent states settle
HORIZONS = (0.3, 1.0, 3.0)  # [s] at which rollouts are judged
CHANNELS = ("vx", "vy", "yaw_rate")
AHEAD = 30  # [rows] known beyond a segment's start, for sensors that report late
EARLIER = 300  # [rows] of commands before a segment: play and slow servos remember them
SMOOTHING = 15  # [rows] of the local parabola; a car's motion bends little within 0.15 s


@dataclass(frozen=True)
class Segments:
    """N segments of L = WARM_UP + H + 1 rows each; rollouts start at row WARM_UP."""

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
    """[N, EARLIER, 2] actions before row 0; the first of a recording stands for those before it."""
    elapsed: Tensor
    """[N] time since the recording began, at row 0 [s]."""
    recording: Tensor
    """[N] int, index of the recording."""
    row: Tensor
    """[N] int, row of the recording that is row 0."""
    dt: float
    """[s]"""

    def __len__(self) -> int:
        return len(self.pose)

    @property
    def horizon(self) -> int:
        """Rows of a rollout (H)."""
        return self.pose.shape[1] - WARM_UP - 1

    @property
    def measured(self) -> Tensor:
        """[N, L, 6] measured pose and velocity."""
        return torch.cat([self.pose, self.velocity], -1)

    @property
    def motion_from_start(self) -> Tensor:
        """[N, H, 6] measured motion of the rollouts; x, y ahead and left of where they start."""
        start = self.smooth_pose[:, WARM_UP : WARM_UP + 1]
        pose, velocity = self.pose[:, WARM_UP + 1 :], self.velocity[:, WARM_UP + 1 :]
        way = pose[..., :2] - start[..., :2]
        position = rotate(way, -start[..., 2].expand(way.shape[:-1]))
        return torch.cat([position, pose[..., 2:] - start[..., 2:], velocity], -1)

    def __getitem__(self, index: Tensor) -> "Segments":
        parts = {n: value[index] for n, value in vars(self).items() if isinstance(value, Tensor)}
        return replace(self, **parts)

    def shortened(self, rows: int) -> "Segments":
        """The same, of rollouts of so many rows."""
        length = WARM_UP + rows + 1
        parts = ("pose", "velocity", "smooth_pose", "smooth_velocity", "action")
        return replace(self, **{name: getattr(self, name)[:, :length] for name in parts})

    def length_blocks(self) -> Tensor:
        """[N] A number shared by segments that start within one length of each other."""
        return self.recording * 1_000_000 + self.row // self.pose.shape[1]

    def spread(self, most: int) -> "Segments":
        """At most so many of them, spread evenly over the recordings."""
        if len(self) <= most:
            return self
        return self[torch.linspace(0, len(self) - 1, most).round().long()]


def cut_segments(
    recordings: Sequence[Recording], seconds: float, stride: float, smoothing: int = SMOOTHING
) -> Segments:
    """Cuts recordings into segments; none crosses a gap.

    Args:
        recordings: All with the same control period.
        seconds: Length of a rollout.
        stride: From the start of one segment to the start of the next [s].
        smoothing: Rows of the local parabola.

    Raises:
        ValueError: No recording has a gap-free segment of that length.
    """
    dt = recordings[0].dt
    length, rows = WARM_UP + round(seconds / dt) + 1, max(1, round(stride / dt))
    measured = windows(recordings, length, rows)
    smooth = windows([_smoothed(r, smoothing) for r in recordings], length, rows)
    first, index = measured[keys.ROW][:, 0], measured[keys.RECORDING][:, 0]
    begun = torch.stack([recording.data[keys.TIME][0, 0] for recording in recordings])
    starts = list(zip(index.tolist(), first.tolist(), strict=True))
    times = torch.stack([recordings[i].data[keys.TIME][row, 0] for i, row in starts])
    return Segments(
        pose=measured[keys.POSE],
        velocity=measured[keys.VELOCITY],
        smooth_pose=smooth[keys.POSE],
        smooth_velocity=smooth[keys.VELOCITY],
        action=measured[keys.ACTION],
        earlier=torch.stack([_earlier(recordings[i], row) for i, row in starts]),
        elapsed=(times - begun[index]).float(),
        recording=index,
        row=first,
        dt=dt,
    )


def _earlier(recording: Recording, row: int) -> Tensor:
    given = recording.data[keys.ACTION][max(0, row - EARLIER) : row + 1]
    return torch.cat([given[:1].expand(EARLIER + 1 - len(given), -1), given])[:-1]


def _smoothed(recording: Recording, rows: int) -> Recording:
    smooth = filtered(recording, rows, local_parabola)
    data = smooth.data
    for segment in data[keys.SEGMENT].unique():
        inside = data[keys.SEGMENT] == segment
        data[keys.POSE][inside] = local_parabola(data[keys.POSE][inside], rows)
    return Recording(smooth.name, TensorDict(data.to_dict(), data.batch_size), smooth.dt)
