"""What the camera of a case records of a motion, with the case's nuisance."""

import random
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from scipy.signal import lfilter
from tensordict import TensorDict
from torch import Tensor

from buggy_rl import keys
from buggy_rl.blind_test.case import Case
from buggy_rl.recordings import Recording, save_recording
from buggy_rl.recordings.camera import DECIMALS, NOISES, Camera, CameraConfig
from buggy_rl.similarity import Similarity
from buggy_rl.vehicle import CONTROL_PERIOD

BASELINE_NOISE = 100  # number of the first baseline drive, behind those of all other drives
RHO = 0.9  # correlation of coloured noise from row to row
JITTER = 1e-3  # [s] standard deviation of a stamp: a host computer that stamps on arrival
DROPPED = 0.002  # share of frames lost: one in five seconds, each of which cuts the drive


def save_drives(
    case: Case, true: TensorDict, folder: Path, numbers: Mapping[str, int], changed: bool = True
) -> None:
    """Records drives of a case, true motion [drives, T], and writes them as CSV files.

    `numbers` is file name, without its ending -> `place` of `measured`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for motion, (name, number) in zip(true, numbers.items(), strict=True):
        save_recording(measured(case, motion, changed, number), folder / f"{name}.csv")


def measured(case: Case, true: TensorDict, changed: bool, place: int) -> Recording:
    """One drive of a case as it is recorded.

    Args:
        case: Says what is wrong with the camera, and the nuisance.
        true: [T] motion.
        changed: Whether what is concealed is there yet; if not, the camera is right.
        place: Number of the drive, which decides its noise.
    """
    seed = case.seed * 1_000 + place
    config = at_scale(CameraConfig(**(case.camera if changed else {})), case.car.similarity)
    for disturbance in case.disturbances if changed else ():
        true = disturbance.seen(true)
    if case.nuisance == "stamps":
        early = random.Random(f"stamps {case.seed}").random() < 0.5
        true = stamped_off(true, early, case.every)
    if case.nuisance == "thrice":
        config = replace(config, **{name: 3 * getattr(config, name) for name in NOISES})
    if case.nuisance == "dropped":
        config = replace(config, dropped_share=DROPPED)
    if case.nuisance == "coloured":
        data = coloured(config, true, seed)
    else:
        data = Camera(config, seed).recorded(true)
    data = thinned(data, case.every)
    if case.nuisance == "jitter":
        data[keys.TIME] = jittered(data[keys.TIME], seed)
    dt = case.every * CONTROL_PERIOD
    return Recording(f"drive_{place}", data, dt, command=case.longitudinal)


def at_scale(config: CameraConfig, scale: Similarity) -> CameraConfig:
    """The camera of a similar car: its noise is as large a part of the motion as the buggy's."""
    units = zip(NOISES, ("m", "rad", "m/s", "rad/s"), strict=True)
    return replace(config, **{n: scale.of(unit) * getattr(config, n) for n, unit in units})


def stamped_off(true: TensorDict, early: bool, rows: int = 1) -> TensorDict:
    """The motion with its commands logged so many rows early, or late; the end's is held."""
    action = true[keys.ACTION]
    held = (action[-1:] if early else action[:1]).expand(rows, -1)
    moved = torch.cat([action[rows:], held] if early else [held, action[:-rows]])
    return true.clone().set(keys.ACTION, moved)


def thinned(data: TensorDict, every: int) -> TensorDict:
    """Of a recording at 100 Hz, the frames of every so many control periods."""
    if every == 1:
        return data
    row = (data[keys.TIME][:, 0] / CONTROL_PERIOD).round().long()
    kept = row % every == 0
    gaps = row[kept].diff(prepend=row[:1]) > every
    columns: dict = {key: value[kept] for key, value in data.items()}
    return TensorDict(columns | {keys.SEGMENT: gaps.cumsum(0)}, int(kept.sum()))


def coloured(config: CameraConfig, true: TensorDict, seed: int) -> TensorDict:
    """Recorded with noise e_k = rho e_(k-1) + sqrt(1 - rho^2) w_k of the camera's own size."""
    quiet = replace(config, **dict.fromkeys(NOISES, 0.0))
    data = Camera(quiet, seed).recorded(true)
    position, yaw, speed, yaw_rate = (getattr(config, name) for name in NOISES)
    noise = correlated(len(data), 6, seed)
    for key, rows, size in (
        (keys.POSE, slice(0, 3), (position, position, yaw)),
        (keys.VELOCITY, slice(3, 6), (speed, speed, yaw_rate)),
    ):
        shown = data[key] + noise[:, rows] * torch.tensor(size)
        data[key] = torch.round(shown, decimals=DECIMALS)
    return data


def correlated(rows: int, columns: int, seed: int) -> Tensor:
    """Noise [rows, columns] of unit variance with correlation `RHO` from row to row."""
    generator = torch.Generator().manual_seed(seed)
    white = torch.randn(rows, columns, generator=generator, dtype=torch.float64).numpy()
    white[1:] *= np.sqrt(1 - RHO**2)  # the first row has the variance that all shall have
    return torch.as_tensor(lfilter([1.0], [1.0, -RHO], white, axis=0)).float()


def jittered(time: Tensor, seed: int) -> Tensor:
    """Stamps [T, 1] that are off by `JITTER`, in order still."""
    generator = torch.Generator().manual_seed(seed)
    off = JITTER * torch.randn(time.shape, generator=generator, dtype=time.dtype)
    return (time + off.clamp(-4 * JITTER, 4 * JITTER)).round(decimals=DECIMALS)
