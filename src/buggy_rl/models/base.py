"""One step of learned dynamics, with all that must travel with the weights."""

from abc import abstractmethod

import torch
from torch import Tensor, nn

from buggy_rl.models.envelope import Envelope

INPUTS = 5  # vx, vy, yaw_rate, throttle, steering
REST_SPEED = 0.06  # [m/s] twice the velocity noise of a tracking camera: below it a car stands
REST_YAW_RATE = 0.15  # [rad/s] likewise
CREEP_SPEED = 1.0  # [m/s] below it a car without drive must lose speed, whatever the network says
NO_DRIVE = -0.98  # throttle up to which nothing drives the car
MARGIN = 0.1  # of the training range's width: how far beyond it a rollout may go


class DynamicsModel(nn.Module):
    """v' = v + s_out * f((history - mean) / s_in), mended at rest and at the edge of the data.

    A network alone creeps and turns at zero throttle, and may run away where it was never
    trained. So a slow car that has had no drive over the whole history loses at least the speed
    that coasting cars were seen to lose, stands still once it is slower than the sensor's noise,
    and velocities stay within the training range widened by a tenth.

    Buffers are fitted to the training data and stored with the weights.
    """

    rows: int
    """Samples of history that go in, the present one included."""
    input_mean: Tensor
    input_scale: Tensor
    output_scale: Tensor
    rest_throttle: Tensor
    """Throttle up to which a standing car stays."""
    coast_loss: Tensor
    """Speed that a car without drive loses in a step, at least [m/s]."""

    def __init__(self, rows: int) -> None:
        super().__init__()
        self.rows = rows
        self.register_buffer("input_mean", torch.zeros(INPUTS))
        self.register_buffer("input_scale", torch.ones(INPUTS))
        self.register_buffer("output_scale", torch.ones(3))
        self.register_buffer("rest_throttle", torch.tensor(NO_DRIVE))
        self.register_buffer("coast_loss", torch.tensor(0.001))
        self.envelope = Envelope()

    @abstractmethod
    def network(self, history: Tensor) -> Tensor:
        """Normalised history [*, rows, 5], oldest first -> normalised change of velocity [*, 3]."""

    def change(self, history: Tensor) -> Tensor:
        """What the network itself says: the change of velocity [*, 3] a step; trained on."""
        return self.network((history - self.input_mean) / self.input_scale) * self.output_scale

    def forward(self, history: Tensor) -> Tensor:
        """The velocity one step later.

        Args:
            history: [*, rows, 5] vx, vy [m/s], yaw_rate [rad/s], throttle, steering; oldest first,
                the last row is the present.

        Returns:
            [*, 3] vx, vy [m/s], yaw_rate [rad/s].
        """
        velocity = history[..., -1, :3]
        following = self.envelope.clamp_velocity(velocity + self.change(history), MARGIN)
        vx, vy, yaw_rate = velocity.unbind(-1)
        speed = torch.hypot(vx, vy)
        highest_throttle = history[..., 3].amax(-1)
        # Without drive: v' shrinks to at most |v| - loss, and yaw rate with it.
        limit = (speed - self.coast_loss).clamp_min(0.0)
        shrink = limit / torch.hypot(following[..., 0], following[..., 1]).clamp_min(1e-6)
        coasting = (highest_throttle <= NO_DRIVE) & (speed < CREEP_SPEED)
        shrink = torch.where(coasting, shrink.clamp_max(1.0), 1.0)
        slow = (speed < REST_SPEED) & (yaw_rate.abs() < REST_YAW_RATE)
        standing = slow & (highest_throttle <= self.rest_throttle)
        return torch.where(standing, 0.0, shrink).unsqueeze(-1) * following
