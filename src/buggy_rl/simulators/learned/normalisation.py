"""Normalisation, envelope and behaviour at rest, fitted to the training data."""

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from torch import Tensor

from buggy_rl.core import keys
from buggy_rl.core.longitudinal import LongitudinalCommand
from buggy_rl.recordings.recording import Recording
from buggy_rl.recordings.windows import model_inputs, windows
from buggy_rl.simulators.learned.base import (
    NO_DRIVE,
    REST_SPEED,
    DynamicsModel,
    Ensemble,
    one_way_throttle,
)

WATCHED = 0.5  # [s] window in which a standing car sets off or a coasting one loses speed; chosen
COASTING = 0.3  # [m/s] initial speed of a coasting window: 12 times the camera's noise
COAST_DECELERATION = 0.1  # [m/s^2] without coasting data; below any rubber tyre's on a floor
SET_OFF = 0.2  # [m/s] speed of a car that has set off: 8 times the camera's noise
THROTTLE_MARGIN = 0.05  # throttle below the lowest that set a car off; chosen
QUANTILE = 0.05  # of throttles and decelerations, taken for their minimum without outliers
RESTING_ROWS = 5  # at the start of a window, all at rest; chosen


def fit_normalisation(
    model: DynamicsModel, data: TensorDictBase, recordings: Sequence[Recording]
) -> None:
    """Sets means, scales, envelope and the behaviour at rest of a model and its members.

    The training windows [N, L] are filtered and mirrored as for the training, `recordings` not.

    Raises:
        ValueError: The recordings' commands are of several kinds.
    """
    command = _one_command(recordings)
    rest_throttle = resting_throttle(recordings)
    coast_loss = coasting_deceleration(recordings) * recordings[0].dt
    rows = model_inputs(data)
    flat = rows.flatten(0, 1)
    change = rows[:, 1:, :3] - rows[:, :-1, :3]
    members = list(model.members) if isinstance(model, Ensemble) else []
    centred = torch.tensor([True, False, False, True, False])  # mean 0: left equals right
    for each in (model, *members):
        assert isinstance(each, DynamicsModel)
        each.command = command
        each.input_mean.copy_(flat.mean(0) * centred)
        each.input_scale.copy_(flat.std(0).clamp_min(1e-3))
        each.output_scale.copy_(change.flatten(0, 1).std(0).clamp_min(1e-5))
        each.envelope.fit(flat)
        each.rest_throttle.fill_(rest_throttle)
        each.coast_loss.fill_(coast_loss)


def _one_command(recordings: Sequence[Recording]) -> LongitudinalCommand:
    first = recordings[0]
    for recording in recordings:
        if recording.command != first.command:
            raise ValueError(
                f"{first.name} has the command {first.command}, {recording.name} "
                f"{recording.command}: a model learns one kind; read them with one column map"
            )
    return first.command


def resting_throttle(recordings: Sequence[Recording]) -> float:
    """The highest throttle at which standing cars stayed at rest for half a second.

    It is at most the lowest throttle (5 % quantile) that set a car off, less a margin. A throttle
    that was never held at rest does not count: a car that stands where it should creep is a larger
    error than one that creeps at a small throttle.
    """
    watched = _watched(recordings)
    if watched is None:
        return NO_DRIVE
    throttle, speed = watched
    resting = speed[:, :RESTING_ROWS].amax(1) < REST_SPEED
    set_off = resting & (speed[:, -1] > SET_OFF)
    stayed = resting & (speed.amax(1) < REST_SPEED)
    if not stayed.any():
        return NO_DRIVE
    highest = throttle[stayed].amin(1).max().item()
    if set_off.any():
        lowest = torch.quantile(throttle[set_off].amax(1), QUANTILE).item() - THROTTLE_MARGIN
        highest = min(highest, lowest)
    return max(NO_DRIVE, highest)


def coasting_deceleration(recordings: Sequence[Recording]) -> float:
    """The least deceleration [m/s^2] (5 % quantile) of cars without drive over half a second.

    Zero where coasting cars gained speed, as on a sloped floor.
    """
    watched = _watched(recordings, strides=5)
    if watched is None:
        return COAST_DECELERATION
    throttle, speed = watched
    length = speed.shape[1]
    tail = length // 5  # rows that are averaged: the sensor is noisy
    first, last = speed[:, :tail].mean(1), speed[:, -tail:].mean(1)
    coasting = (throttle <= NO_DRIVE).all(1) & (first > COASTING) & (last > REST_SPEED)
    if not coasting.any():
        return COAST_DECELERATION
    loss = (first - last)[coasting] / (WATCHED * (1 - tail / length))
    return max(0.0, torch.quantile(loss, QUANTILE).item())


def _watched(recordings: Sequence[Recording], strides: int = 0) -> tuple[Tensor, Tensor] | None:
    """Throttle, as of `one_way_throttle`, and speed [N, L] in windows of half a second.

    None if no segment is that long.

    Windows start at every row, or `strides` times in a window's length.
    """
    length = round(WATCHED / recordings[0].dt)
    try:
        cut = windows(recordings, length, length // strides if strides else 1)
    except ValueError:
        return None
    throttle = one_way_throttle(cut[keys.ACTION][..., 0], recordings[0].command.rest)
    return throttle, torch.linalg.vector_norm(cut[keys.VELOCITY][..., :2], dim=-1)
