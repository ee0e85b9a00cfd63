"""From recordings to what a model is trained and judged on: windows, filters, mirroring, splits."""

import zlib
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Literal

import torch
from scipy.signal import savgol_filter
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from buggy_rl import keys
from buggy_rl.recordings.recording import Recording
from buggy_rl.vehicle import rotate

Preparation = Literal["raw", "filtered", "mirrored"]
"""`filtered`: causal past-mean of the velocities; `mirrored`: filtered, and left/right doubled."""


def windows(recordings: Sequence[Recording], length: int, stride: int) -> TensorDict:
    """Cuts stretches of equal length out of drives; none crosses a gap.

    Args:
        recordings: Drives; all with the same control period.
        length: Rows of a window.
        stride: Rows between the starts of neighbouring windows.

    Returns:
        TensorDict [N, length] with `pose` [3], `velocity` [3], `action` [2], and the window's
        drive and first row as `recording` and `row`, both [N, length] and constant in a window.

    Raises:
        ValueError: No drive has a gap-free stretch of that length.
    """
    parts = []
    for index, recording in enumerate(recordings):
        starts = window_starts(recording.data[keys.SEGMENT], length, stride)
        rows = starts[:, None] + torch.arange(length)  # (n, length)
        part = recording.data.select(keys.POSE, keys.VELOCITY, keys.ACTION)[rows]
        part[keys.RECORDING] = torch.full_like(rows, index)
        part[keys.ROW] = starts[:, None].expand_as(rows).clone()
        parts.append(part)
    result = TensorDict.cat(parts) if parts else TensorDict(batch_size=[0])
    if len(result) == 0:
        names = ", ".join(r.name for r in recordings) or "no drives at all"
        raise ValueError(
            f"no gap-free stretch of {length} rows in {names}: drive longer, or ask for less"
        )
    return result


def window_starts(segment: Tensor, length: int, stride: int) -> Tensor:
    """First rows [n] of the windows that fit into the segments [T] of a drive."""
    edges = torch.nonzero(segment.diff()).flatten() + 1
    bounds = [0, *edges.tolist(), len(segment)]
    starts = [
        torch.arange(begin, end - length + 1, stride)
        for begin, end in pairwise(bounds)
        if end - begin >= length
    ]
    return torch.cat(starts) if starts else torch.empty(0, dtype=torch.long)


def model_inputs(data: TensorDictBase) -> Tensor:
    """Velocity and action of rows as one tensor [*, 5]: what a learned model looks at."""
    return torch.cat([data[keys.VELOCITY], data[keys.ACTION]], -1)


def relative_pose(pose: Tensor) -> Tensor:
    """Poses [*, L, 3] seen from the first one: that is at the origin, heading along x."""
    start = pose[..., :1, :]
    heading = start[..., 2].expand(pose.shape[:-1])
    position = rotate(pose[..., :2] - start[..., :2], -heading)
    return torch.cat([position, pose[..., 2:] - start[..., 2:]], -1)


def past_mean(signal: Tensor, width: int) -> Tensor:
    """Causal mean of the last `width` rows, as it can run on the car.

    y_t = (x_{t-width+1} + ... + x_t) / width; at the start the mean of what there is.

    Args:
        signal: [T, C].
        width: Rows, the present one included.
    """
    total = torch.cumsum(signal.double(), 0)
    shifted = torch.zeros_like(total)
    shifted[width:] = total[:-width]
    count = torch.arange(1, len(signal) + 1, device=signal.device).clamp_max(width)
    return ((total - shifted) / count[:, None]).to(signal.dtype)


def centred_mean(signal: Tensor, width: int) -> Tensor:
    """Mean over `width` rows around each row; looks ahead, so it cannot run on the car.

    Args:
        signal: [T, C].
        width: Rows, odd; at the ends the mean of what there is.
    """
    if width % 2 == 0:
        raise ValueError(f"a centred mean needs an odd width, got {width}")
    half = width // 2
    total = torch.cumsum(signal.double(), 0)
    total = torch.cat([torch.zeros_like(total[:1]), total])  # (T + 1, C)
    row = torch.arange(len(signal), device=signal.device)
    begin, end = (row - half).clamp_min(0), (row + half + 1).clamp_max(len(signal))
    return ((total[end] - total[begin]) / (end - begin)[:, None]).to(signal.dtype)


def local_parabola(signal: Tensor, width: int) -> Tensor:
    """Savitzky-Golay smoothing of second order: keeps slopes and bends that a mean would cut off.

    Looks ahead, so it cannot run on the car.

    Args:
        signal: [T, C].
        width: Rows, odd; a signal shorter than that is left as it is.
    """
    if width % 2 == 0:
        raise ValueError(f"a local parabola needs an odd width, got {width}")
    if len(signal) < width:
        return signal.clone()
    return torch.as_tensor(savgol_filter(signal.numpy(), width, 2, axis=0), dtype=signal.dtype)


def filtered(
    recording: Recording, width: int, smoother: Callable[[Tensor, int], Tensor] = past_mean
) -> Recording:
    """The drive with smoothed velocities, segment by segment; the drive itself is left as it is."""
    data = recording.data.clone()
    for segment in data[keys.SEGMENT].unique():
        rows = data[keys.SEGMENT] == segment
        data[keys.VELOCITY][rows] = smoother(data[keys.VELOCITY][rows], width)
    notes = [*recording.notes, f"velocities: {smoother.__name__} over {width} rows"]
    return Recording(recording.name, data, recording.dt, recording.source, notes)


def mirror(data: TensorDictBase) -> TensorDictBase:
    """Left for right: `[vx, -vy, -yaw_rate, throttle, -steering]`, and the pose likewise."""
    flip = torch.tensor([1.0, -1.0, -1.0], device=data.device)
    flipped = data.clone()
    flipped[keys.POSE] = data[keys.POSE] * flip
    flipped[keys.VELOCITY] = data[keys.VELOCITY] * flip
    flipped[keys.ACTION] = data[keys.ACTION] * flip[:2]
    return flipped


def split(
    recordings: Sequence[Recording], held_out: Sequence[str] | float, seed: int = 0
) -> tuple[list[Recording], list[Recording]]:
    """Splits by whole drives into (training, held out).

    Args:
        recordings: All drives.
        held_out: Names of the drives to hold out, or the share of them (at least one drive).
        seed: Which drives, when a share is given; the same names always fall on the same side.

    Raises:
        ValueError: A name is not there, or one side would be empty.
    """
    names = [r.name for r in recordings]
    if isinstance(held_out, (int, float)):
        order = sorted(names, key=lambda name: zlib.crc32(f"{seed}:{name}".encode()))
        chosen = set(order[: max(1, round(held_out * len(names)))])
    else:
        chosen = set(held_out)
        missing = sorted(chosen - set(names))
        if missing:
            raise ValueError(f"cannot hold out {missing}: the drives are {sorted(names)}")
    training = [r for r in recordings if r.name not in chosen]
    held = [r for r in recordings if r.name in chosen]
    if not training or not held:
        raise ValueError(
            f"{len(names)} drive(s) cannot be split into training and held out: record another"
        )
    return training, held
