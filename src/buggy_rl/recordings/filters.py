"""Filters of the recorded velocities."""

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import torch
from scipy.signal import savgol_filter
from torch import Tensor

from buggy_rl import keys
from buggy_rl.recordings.recording import Recording

Preparation = Literal["raw", "filtered", "mirrored"]
"""`filtered`: causal mean of the velocities; `mirrored`: filtered, plus the left/right mirror."""


def past_mean(signal: Tensor, width: int) -> Tensor:
    """Causal mean of the last `width` rows of a signal [T, C], the present one included.

    y_t = (x_{t-width+1} + ... + x_t) / width; the first rows average the rows there are.
    """
    total = torch.cumsum(signal.double(), 0)
    shifted = torch.zeros_like(total)
    shifted[width:] = total[:-width]
    count = torch.arange(1, len(signal) + 1, device=signal.device).clamp_max(width)
    return ((total - shifted) / count[:, None]).to(signal.dtype)


def local_parabola(signal: Tensor, width: int) -> Tensor:
    """Savitzky-Golay filter of second order: preserves slope and curvature. Not causal.

    A signal [T, C] of fewer than `width` rows is returned unchanged.

    Raises:
        ValueError: The width is even.
    """
    if width % 2 == 0:
        raise ValueError(f"local_parabola: width is {width} rows; use an odd number")
    if len(signal) < width:
        return signal.clone()
    return torch.as_tensor(savgol_filter(signal.numpy(), width, 2, axis=0), dtype=signal.dtype)


def filtered(
    recording: Recording, width: int, smoother: Callable[[Tensor, int], Tensor] = past_mean
) -> Recording:
    """Returns a copy of the recording with its velocities filtered segment by segment."""
    data = recording.data.clone()
    for segment in data[keys.SEGMENT].unique():
        rows = data[keys.SEGMENT] == segment
        data[keys.VELOCITY][rows] = smoother(data[keys.VELOCITY][rows], width)
    notes = [*recording.notes, f"velocities: {smoother.__name__} over {width} rows"]
    return replace(recording, data=data, notes=notes)
