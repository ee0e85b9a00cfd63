"""What a model takes from its training data beside the weights."""

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase

from buggy_rl import keys
from buggy_rl.dataset import model_inputs, windows
from buggy_rl.models.base import REST_SPEED, DynamicsModel
from buggy_rl.models.ensemble import Ensemble
from buggy_rl.recordings.recording import Recording

REST_WATCH = 0.5  # [s] how long a standing car is watched for setting off
SET_OFF = 0.2  # [m/s] a car that has reached this has set off; sensor noise never reads it
THROTTLE_MARGIN = 0.05  # below the lowest throttle that set a car off
NO_THROTTLE = -0.98  # taken for no drive when the data hold no standing car


def fit_normalisation(model: DynamicsModel, data: TensorDictBase, rest_throttle: float) -> None:
    """Means, scales and envelope from training windows [N, L], into the model and its members."""
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


def resting_throttle(recordings: Sequence[Recording]) -> float:
    """The throttle up to which no standing car was seen to set off.

    Stretches of half a second that begin at rest are looked at; the answer lies a little below
    the lowest throttle (5 % quantile) that made one move. It errs low: a car that stands where it
    should creep forward is worse than one that may creep at a little throttle. Without a start
    from rest in the data it is just above no drive.
    """
    length = round(REST_WATCH / recordings[0].dt)
    try:
        stretches = windows(recordings, length, 1)
    except ValueError:  # no drive is that long
        return NO_THROTTLE
    speed = torch.linalg.vector_norm(stretches[keys.VELOCITY][..., :2], dim=-1)
    set_off = (speed[:, :5].amax(1) < REST_SPEED) & (speed[:, -1] > SET_OFF)
    if not set_off.any():
        return NO_THROTTLE
    throttle = stretches[keys.ACTION][set_off][..., 0].amax(1)
    return max(NO_THROTTLE, torch.quantile(throttle, 0.05).item() - THROTTLE_MARGIN)
