"""What a model takes from its training data beside the weights."""

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase

from buggy_rl import keys
from buggy_rl.models.base import NO_DRIVE, REST_SPEED, DynamicsModel
from buggy_rl.models.ensemble import Ensemble
from buggy_rl.recordings.recording import Recording
from buggy_rl.recordings.windows import model_inputs, windows

REST_WATCH = 0.5  # [s] how long a standing car is watched for setting off, a coasting one for loss
COASTING = 0.3  # [m/s] speed from which coasting tells a deceleration
COAST_DECELERATION = 0.1  # [m/s^2] taken when the data hold no coasting; any rubber tyre loses more
SET_OFF = 0.2  # [m/s] a car that has reached this has set off; sensor noise never reads it
THROTTLE_MARGIN = 0.05  # below the lowest throttle that set a car off


def fit_normalisation(
    model: DynamicsModel, data: TensorDictBase, recordings: Sequence[Recording]
) -> None:
    """Means, scales, envelope and resting behaviour, into a model and its members.

    Args:
        model: The model.
        data: Training windows [N, L], as the model is trained on them.
        recordings: The drives they were cut from.
    """
    rest_throttle = resting_throttle(recordings)
    coast_loss = coasting_deceleration(recordings) * recordings[0].dt
    rows = model_inputs(data)
    flat = rows.flatten(0, 1)
    change = rows[:, 1:, :3] - rows[:, :-1, :3]
    members = list(model.members) if isinstance(model, Ensemble) else []
    centred = torch.tensor([True, False, False, True, False])  # left and right weigh the same
    for each in (model, *members):
        assert isinstance(each, DynamicsModel)
        each.input_mean.copy_(flat.mean(0) * centred)
        each.input_scale.copy_(flat.std(0).clamp_min(1e-3))
        each.output_scale.copy_(change.flatten(0, 1).std(0).clamp_min(1e-5))
        each.envelope.fit(flat)
        each.rest_throttle.fill_(rest_throttle)
        each.coast_loss.fill_(coast_loss)


def resting_throttle(recordings: Sequence[Recording]) -> float:
    """The throttle up to which standing cars were seen to stay where they are.

    Stretches of half a second that begin at rest are looked at. The answer is the highest
    throttle held over such a stretch without setting off, but below the lowest (5 % quantile)
    that did set one off. What was never tried does not count as rest: a car that stands where it
    should creep forward is worse than one that may creep at a little throttle.
    """
    length = round(REST_WATCH / recordings[0].dt)
    try:
        stretches = windows(recordings, length, 1)
    except ValueError:  # no drive is that long
        return NO_DRIVE
    speed = torch.linalg.vector_norm(stretches[keys.VELOCITY][..., :2], dim=-1)
    throttle = stretches[keys.ACTION][..., 0]
    resting = speed[:, :5].amax(1) < REST_SPEED
    set_off = resting & (speed[:, -1] > SET_OFF)
    stayed = resting & (speed.amax(1) < REST_SPEED)
    if not stayed.any():
        return NO_DRIVE
    highest = throttle[stayed].amin(1).max().item()
    if set_off.any():
        lowest = torch.quantile(throttle[set_off].amax(1), 0.05).item() - THROTTLE_MARGIN
        highest = min(highest, lowest)
    return max(NO_DRIVE, highest)


def coasting_deceleration(recordings: Sequence[Recording]) -> float:
    """The least deceleration [m/s^2] (5 % quantile) at which cars were seen to coast.

    Over stretches of half a second without drive; zero where coasting cars gained speed, as on a
    sloped floor.
    """
    length = round(REST_WATCH / recordings[0].dt)
    try:
        stretches = windows(recordings, length, length // 5)
    except ValueError:  # no drive is that long
        return COAST_DECELERATION
    undriven = (stretches[keys.ACTION][..., 0] <= NO_DRIVE).all(1)
    speed = torch.linalg.vector_norm(stretches[keys.VELOCITY][..., :2], dim=-1)
    tail = length // 5  # the mean over a fifth of the stretch: the sensor is noisy
    first, last = speed[:, :tail].mean(1), speed[:, -tail:].mean(1)
    coasting = undriven & (first > COASTING) & (last > REST_SPEED)
    if not coasting.any():
        return COAST_DECELERATION
    loss = (first - last)[coasting] / (REST_WATCH * (1 - tail / length))
    return max(0.0, torch.quantile(loss, 0.05).item())
