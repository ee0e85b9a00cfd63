"""A brush tyre with parabolic pressure and a relaxation length; Pacejka 2012, ch. 3 and 7.

The first axis of tensors is the wheel: front left, front right, rear left, rear right. It stands
before the batch, so that a number per environment broadcasts over its wheels. Vectors at the wheels
are [2, 4, *]: along the wheel (forward), across it (to the left).
"""

from collections.abc import Mapping

import torch
from torch import Tensor

from buggy_rl.core.vehicle import Similarity
from buggy_rl.simulators.reference.faults import Faults

LEFT_RIGHT = (1.0, -1.0)  # y of the wheels of an axle in half track widths
# Speeds of a buggy:
STANDSTILL_SPEED = 0.05  # [m/s] keeps the slip of a standing tyre finite; chosen
DAMPING_SPEED = 1.0  # [m/s] above it the rolling itself damps the carcass; chosen
SLIPPERY = 0.15  # [-] friction lost by sliding over friction lost by a worn or wet tyre; chosen
TINY = 1e-12  # under the roots, for a gradient at zero slip


def per_wheel(front: Tensor, rear: Tensor) -> Tensor:
    """[4, *] from the values [*] of the front and of the rear wheels."""
    front, rear = torch.broadcast_tensors(front, rear)
    return torch.stack([front, front, rear, rear])


def sides(like: Tensor) -> Tensor:
    """[2, *1]: +1 for the left wheel of an axle and -1 for the right; ones beside the batch."""
    signs = torch.tensor(LEFT_RIGHT, dtype=like.dtype, device=like.device)
    return signs.reshape(2, *[1] * like.dim())


class Tyres:
    """The four tyres; all tensors with the axis of wheels first.

    Args:
        values: Parameter name -> value, each [*] or ones in place of the batch.
        static_load: [4, *] load of each wheel at rest [N].
        faults: Of the rubber.
        similarity: Ratios of the car to the buggy.
    """

    def __init__(
        self,
        values: Mapping[str, Tensor],
        static_load: Tensor,
        faults: Faults | None = None,
        similarity: Similarity | None = None,
    ) -> None:
        faults = faults or Faults({}, values["grip"])
        speed = (similarity or Similarity()).speed
        self.standstill, self.damped_below = speed * STANDSTILL_SPEED, speed * DAMPING_SPEED
        balance = faults["grip_balance.front_to_rear"].sqrt()
        grip = values["grip"] * faults["tire_grip.grip"]
        self.grip = per_wheel(grip * balance, grip / balance)
        self.load_loss = values["grip_load_loss"] / static_load
        self.load_gain = 1.0 - values["grip_load_loss"]
        worn = SLIPPERY * (1.0 - faults["tire_grip.grip"])
        self.sliding_loss = values["grip_sliding_loss"] + worn
        self.sliding_speed = values["sliding_speed"]
        along = per_wheel(values["longitudinal_stiffness"], values["longitudinal_stiffness"])
        softer = faults["cornering_stiffness.ratio"]
        across = per_wheel(
            softer * values["front_cornering_stiffness"],
            softer * values["rear_cornering_stiffness"],
        )
        self.stiffness = torch.stack(torch.broadcast_tensors(along, across))  # (2, 4, *)
        self.relaxation_length = values["relaxation_length"]
        self.carcass_damping = values["carcass_damping"]

    def transport_speed(self, along: Tensor, across: Tensor, tread: Tensor) -> Tensor:
        """Speed [4, *] at which the tyre's contact is renewed [m/s].

        w = sqrt(max(v_along^2 + v_across^2, u^2) + w0^2): the faster of ground and tread, so that
        slip stays within +-2 also with spinning or locked wheels and in a sideways slide.
        """
        fastest = torch.maximum(along.square() + across.square(), tread.square())
        return (fastest + self.standstill**2).sqrt()

    def relaxed(
        self, slip: Tensor, slip_speed: Tensor, transport: Tensor, dt: float
    ) -> tuple[Tensor, Tensor]:
        """Slip of the carcass after a step: it follows the slip at the ground.

        L ds/dt = v_slip - w s, by the trapezoidal rule; at a standstill the tyre becomes a spring.
        The carcass also resists its own deforming: s_eff = s + tau ds/dt, tau falling with speed.

        Args:
            slip: [2, 4, *] carried slip.
            slip_speed: [2, 4, *] tread over ground, along and across [m/s].
            transport: [4, *] see `transport_speed` [m/s].
            dt: Step [s].

        Returns:
            [2, 4, *] the carried slip and the effective slip after the step.
        """
        reach = dt / self.relaxation_length
        half = 0.5 * transport * reach  # well below 1, so the rule does not ring
        following = (slip * (1.0 - half) + slip_speed * reach) / (1.0 + half)
        tau = self.carcass_damping * self.damped_below / (self.damped_below + transport)
        return following, following + (following - slip) * (tau / dt)

    def friction(self, load: Tensor, slip_speed: Tensor) -> Tensor:
        """Friction coefficient [4, *] at this load [N] and sliding speed [2, 4, *] [m/s].

        mu = mu0 / (1 + p (F_z / F_z0 - 1)) (1 - q v_s / (v_s + v_q)).
        """
        sliding = (slip_speed.square().sum(0) + TINY).sqrt()
        loss = self.sliding_loss * sliding / (sliding + self.sliding_speed)
        return self.grip * (1.0 - loss) / (self.load_gain + self.load_loss * load)

    def strain(self, slip: Tensor, friction: Tensor) -> Tensor:
        """Sliding share of the contact [4, *] at a slip [2, 4, *]; from 1 on all of it slides.

        z = |(c_along s_along, c_across s_across)| / (3 mu).
        """
        return ((self.stiffness * slip).square().sum(0) + TINY).sqrt() / (3.0 * friction)

    def force(self, effective_slip: Tensor, load: Tensor, strain: Tensor) -> Tensor:
        """Force [2, 4, *] of the ground on the tyre [N].

        Bristles on a parabolic pressure: with e = (c_along s_along, c_across s_across) and
        z = |e| / (3 mu),  F = mu F_z (1 - (1 - min(z, 1))^3) e / |e|; so |F| <= mu F_z.

        Args:
            effective_slip: [2, 4, *] see `relaxed`.
            load: [4, *] normal load [N].
            strain: [4, *] z of the effective slip.
        """
        held = strain.clamp_max(1.0)
        # mu (1 - (1 - z)^3) / |e| = (3 - 3 z + z^2) / 3 while sticking, 1 / (3 z) once sliding.
        share = (3.0 - 3.0 * held + held.square()) / (3.0 * strain.clamp_min(1.0))
        return self.stiffness * effective_slip * (load * share)
