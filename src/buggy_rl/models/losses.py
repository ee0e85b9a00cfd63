"""What a model is trained on: the error of one step, or of a rollout on its own states."""

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn

from buggy_rl import keys
from buggy_rl.models.base import DynamicsModel
from buggy_rl.recordings.windows import model_inputs, relative_pose
from buggy_rl.vehicle import integrate_pose

VELOCITY_WEIGHT = 4.0  # of the velocity error against the pose error; both are of order one
POSE_SCALE = 0.02  # [m] and [rad]: the pose error that counts as one right at the start
POSE_GROWTH = 0.2  # [s] after which twice that error counts as one: errors grow with time


def one_step_loss(model: DynamicsModel, batch: TensorDictBase) -> Tensor:
    """Mean squared error of the normalised change of velocity, the original's loss.

    Args:
        model: The model.
        batch: Windows [B, rows + 1] or longer; the first `rows` go in, the next one is the label.
    """
    history = model_inputs(batch)[:, : model.rows]
    velocity = batch[keys.VELOCITY]
    label = velocity[:, model.rows] - velocity[:, model.rows - 1]  # (B, 3)
    error = (model.change(history) - label) / model.output_scale
    return error.square().mean()


def rollout_loss(model: DynamicsModel, batch: TensorDictBase, horizon: int, dt: float) -> Tensor:
    """Error of velocity and pose along `horizon` steps on the model's own states.

    Huber, so that a glitch of the camera does not lead: mean over steps of the velocity error in
    standard deviations of velocity, and of the pose error in units of `POSE_SCALE` that grow with
    the time passed.

    Args:
        model: The model.
        batch: Windows [B, rows + horizon] or longer.
        horizon: Steps.
        dt: Control period [s].
    """
    rows, data = model.rows, model_inputs(batch)
    history, velocity = data[:, :rows], data[:, rows - 1, :3]
    pose = torch.zeros_like(velocity)  # relative to the start, in the starting heading
    measured_pose = relative_pose(batch[keys.POSE][:, rows - 1 :])  # (B, horizon + 1, 3)
    speed_scale = model.input_scale[:3]
    elapsed = torch.arange(1, horizon + 1) * dt
    velocities, poses = [], []
    for step in range(horizon):
        following = velocity + model.change(history)
        pose = integrate_pose(pose, velocity, following, dt)
        velocities.append(following)
        poses.append(pose)
        if step < horizon - 1:
            row = torch.cat([following, data[:, rows + step, 3:]], -1)
            history = torch.cat([history[:, 1:], row.unsqueeze(1)], 1)
        velocity = following
    made_velocity, made_pose = torch.stack(velocities, 1), torch.stack(poses, 1)
    speed_error = (made_velocity - data[:, rows : rows + horizon, :3]) / speed_scale
    allowed = POSE_SCALE * (1 + elapsed / POSE_GROWTH).unsqueeze(-1)  # [m], and [rad] for yaw
    pose_error = (made_pose - measured_pose[:, 1 : horizon + 1]) / allowed
    return VELOCITY_WEIGHT * _huber(speed_error) + _huber(pose_error)


def _huber(error: Tensor) -> Tensor:
    return nn.functional.huber_loss(error, torch.zeros_like(error))
