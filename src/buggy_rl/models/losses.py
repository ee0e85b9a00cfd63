"""Training losses: the error of one step, or of a rollout on the model's own states."""

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn

from buggy_rl import keys
from buggy_rl.models.base import DynamicsModel
from buggy_rl.recordings.windows import model_inputs, relative_pose
from buggy_rl.vehicle import integrate_pose

VELOCITY_WEIGHT = 4.0  # of the velocity error over the pose error; both of order one; chosen
POSE_SCALE = 0.02  # [m] and [rad] pose error that counts as one at the start; chosen
POSE_GROWTH = 0.2  # [s] after which twice `POSE_SCALE` counts as one: errors grow; chosen


def one_step_loss(model: DynamicsModel, batch: TensorDictBase) -> Tensor:
    """Mean squared error of the normalised change of velocity, as in the original study.

    Windows are [B, rows + 1] or longer: `rows` of input, then the label.
    """
    history = model_inputs(batch)[:, : model.rows]
    velocity = batch[keys.VELOCITY]
    label = velocity[:, model.rows] - velocity[:, model.rows - 1]  # (B, 3)
    error = (model.change(history) - label) / model.output_scale
    return error.square().mean()


def rollout_loss(model: DynamicsModel, batch: TensorDictBase, horizon: int, dt: float) -> Tensor:
    """Error of velocity and pose along `horizon` steps on the model's own states.

    L = VELOCITY_WEIGHT H((v - v_m) / s_v) + H((p - p_m) / (POSE_SCALE (1 + t / POSE_GROWTH))),
    with H the mean Huber loss, which is insensitive to glitches of the camera, and s_v the
    standard deviation of the velocities. Windows are [B, rows + horizon] or longer; dt in [s].
    """
    rows, data = model.rows, model_inputs(batch)
    history, velocity = data[:, :rows], data[:, rows - 1, :3]
    pose = torch.zeros_like(velocity)  # in the frame of the first pose
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
    speed_error = (torch.stack(velocities, 1) - data[:, rows : rows + horizon, :3]) / speed_scale
    allowed = POSE_SCALE * (1 + elapsed / POSE_GROWTH).unsqueeze(-1)  # [m], and [rad] for yaw
    pose_error = (torch.stack(poses, 1) - measured_pose[:, 1 : horizon + 1]) / allowed
    return VELOCITY_WEIGHT * _huber(speed_error) + _huber(pose_error)


def _huber(error: Tensor) -> Tensor:
    return nn.functional.huber_loss(error, torch.zeros_like(error))
