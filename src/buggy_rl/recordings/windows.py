"""Windows: sections of equal length of recordings; training and held-out recordings."""

import zlib
from collections.abc import Sequence
from itertools import pairwise

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from buggy_rl.core import keys
from buggy_rl.core.vehicle import rotate
from buggy_rl.recordings.recording import Recording


def windows(recordings: Sequence[Recording], length: int, stride: int) -> TensorDict:
    """Cuts windows out of recordings; no window crosses a gap.

    Args:
        recordings: Recordings of one control period.
        length: Rows of a window.
        stride: Rows between the starts of consecutive windows.

    Returns:
        TensorDict [N, length] with `pose` [3], `velocity` [3], `action` [2], and the window's
        recording and first row as `recording` and `row`, both [N, length], constant in a window.

    Raises:
        ValueError: No recording has a segment of that length.
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
        names = ", ".join(r.name for r in recordings) or "(none)"
        raise ValueError(
            f"recordings {names}: no gap-free segment of {length} rows; record longer segments "
            "or use shorter windows"
        )
    return result


def window_starts(segment: Tensor, length: int, stride: int) -> Tensor:
    """First rows [n] of the windows that fit into the segments [T] of a recording."""
    edges = torch.nonzero(segment.diff()).flatten() + 1
    bounds = [0, *edges.tolist(), len(segment)]
    starts = [
        torch.arange(begin, end - length + 1, stride)
        for begin, end in pairwise(bounds)
        if end - begin >= length
    ]
    return torch.cat(starts) if starts else torch.empty(0, dtype=torch.long)


def model_inputs(data: TensorDictBase) -> Tensor:
    """Velocity and action [*, 5], the inputs of a learned model."""
    return torch.cat([data[keys.VELOCITY], data[keys.ACTION]], -1)


def relative_pose(pose: Tensor) -> Tensor:
    """Poses [*, L, 3] in the frame of the first one."""
    start = pose[..., :1, :]
    heading = start[..., 2].expand(pose.shape[:-1])
    position = rotate(pose[..., :2] - start[..., :2], -heading)
    return torch.cat([position, pose[..., 2:] - start[..., 2:]], -1)


def mirror(data: TensorDictBase) -> TensorDictBase:
    """Mirrors left and right: [vx, -vy, -yaw_rate], [throttle, -steering], [x, -y, -yaw]."""
    flip = torch.tensor([1.0, -1.0, -1.0], device=data.device)
    flipped = data.clone()
    flipped[keys.POSE] = data[keys.POSE] * flip
    flipped[keys.VELOCITY] = data[keys.VELOCITY] * flip
    flipped[keys.ACTION] = data[keys.ACTION] * flip[:2]
    return flipped


def split(
    recordings: Sequence[Recording], held_out: Sequence[str] | float, seed: int = 0
) -> tuple[list[Recording], list[Recording]]:
    """Splits by whole recordings into (training, held out).

    Args:
        recordings: All recordings.
        held_out: Names of the recordings to hold out, or their share (at least one recording).
        seed: Selects the recordings of a share; the choice depends on the names, not their order.

    Raises:
        ValueError: A name does not exist, or one side would be empty.
    """
    names = [r.name for r in recordings]
    if isinstance(held_out, (int, float)):
        order = sorted(names, key=lambda name: zlib.crc32(f"{seed}:{name}".encode()))
        chosen = set(order[: max(1, round(held_out * len(names)))])
    else:
        chosen = set(held_out)
        missing = sorted(chosen - set(names))
        if missing:
            raise ValueError(f"cannot hold out {missing}; available recordings: {sorted(names)}")
    training = [r for r in recordings if r.name not in chosen]
    held = [r for r in recordings if r.name in chosen]
    if not training or not held:
        raise ValueError(
            f"{len(names)} recording(s) cannot be split into training and held out: record more"
        )
    return training, held
