"""One step of learned dynamics, with the buffers that are saved with the weights."""

from abc import abstractmethod

import torch
from torch import Tensor, nn

from buggy_rl.longitudinal import ONE_WAY, ONE_WAY_REST, LongitudinalCommand
from buggy_rl.models.envelope import Envelope

INPUTS = 5  # vx, vy, yaw_rate, throttle, steering
REST_SPEED = 0.06  # [m/s] highest speed of a standing car: 2.4 times the camera's noise
REST_YAW_RATE = 0.15  # [rad/s] highest yaw rate of a standing car: 5 times the gyroscope noise
CREEP_SPEED = 1.0  # [m/s] speed below which a car without drive loses speed; chosen
NO_DRIVE = -0.98  # highest throttle without drive: 1 % of it, a sixteenth of DART's deadband
MARGIN = 0.1  # of the training range's width, by which a rollout may leave it; chosen


def asked(throttle: Tensor, rest: float) -> Tensor:
    """Throttle [*] as of a one-way car, -1 is no drive: with reverse |u| - 1, both ways alike."""
    return throttle if rest == ONE_WAY_REST else throttle.abs() - 1


class DynamicsModel(nn.Module):
    """v' = v + s_out * f((history - mean) / s_in), constrained at rest and to the training range.

    A bare network creeps and turns at zero throttle, and may diverge outside its training range.
    Three constraints prevent it: a slow car without drive over the whole history loses at least
    the speed that recorded cars lose while coasting; it stands still once it is slower than the
    sensor noise; velocities stay within the training range widened by `MARGIN`.

    Of a command with reverse "without drive" is near 0, not at the lower end. Buffers are fitted to
    the training data and saved with the weights.
    """

    command: LongitudinalCommand = ONE_WAY
    """What the throttle of the training data is."""

    def __init__(self, rows: int) -> None:
        super().__init__()
        self.rows = rows  # of history, the present one included
        self.input_mean = nn.Buffer(torch.zeros(INPUTS))
        self.input_scale = nn.Buffer(torch.ones(INPUTS))
        self.output_scale = nn.Buffer(torch.ones(3))
        self.rest_throttle = nn.Buffer(torch.tensor(NO_DRIVE))  # highest at rest, of `asked`
        self.coast_loss = nn.Buffer(torch.tensor(0.001))  # [m/s] a step, at least
        self.envelope = Envelope()

    @abstractmethod
    def network(self, history: Tensor) -> Tensor:
        """Normalised history [*, rows, 5], oldest first -> normalised change of velocity [*, 3]."""

    def change(self, history: Tensor) -> Tensor:
        """The unconstrained change of velocity [*, 3] in a step, which is trained."""
        return self.network((history - self.input_mean) / self.input_scale) * self.output_scale

    def forward(self, history: Tensor) -> Tensor:
        """Returns the velocity one step later.

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
        highest_throttle = asked(history[..., 3], self.command.rest).amax(-1)
        # Without drive: v' shrinks to at most |v| - loss, and yaw rate with it.
        limit = (speed - self.coast_loss).clamp_min(0.0)
        shrink = limit / torch.hypot(following[..., 0], following[..., 1]).clamp_min(1e-6)
        coasting = (highest_throttle <= NO_DRIVE) & (speed < CREEP_SPEED)
        shrink = torch.where(coasting, shrink.clamp_max(1.0), 1.0)
        slow = (speed < REST_SPEED) & (yaw_rate.abs() < REST_YAW_RATE)
        standing = slow & (highest_throttle <= self.rest_throttle)
        return torch.where(standing, 0.0, shrink).unsqueeze(-1) * following
