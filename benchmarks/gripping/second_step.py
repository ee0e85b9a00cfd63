"""`tire_grip` by a second step of the simulator, in place of a tyre law; not used by the package.

F'(slip) = q F(slip / q): the simulator is stepped again from a velocity at which the slip angles of
both axles are 1 / q of what they are, and q times its axle forces are those of the changed car.
With y an axle's lateral velocity, delta the road-wheel angle and L the wheelbase,

    y_f* = y_f / q + (1 - 1 / q) vx tan(delta),  y_r* = y_r / q,  r* = (y_f* - y_r*) / L.

In a step of the changed car slip drifts by the turning of its frame, -vx r / q in these units, in
the second step by -vx r*: half of the difference is added to y*, so that their means agree.
"""

from dataclasses import replace

import torch
from tensordict import TensorDictBase
from torch import Tensor

from buggy_rl.core import keys
from buggy_rl.core.vehicle import shift_velocity
from buggy_rl.effects.motion.base import Motion
from buggy_rl.effects.tyre.change import FrictionChange, _in_front
from buggy_rl.effects.tyre.grip import TireGrip


class SecondStep(TireGrip):
    """As `TireGrip`, for environments that all have it; `max_acceleration` is not kept."""

    def _write_step(self, before: TensorDictBase, after: TensorDictBase) -> None:
        self._before = before
        super()._write_step(before, after)

    def _stepped(self, at_cg: Tensor) -> Tensor:
        """Velocity [n, 3] a step after another one, at the centre of gravity."""
        arm = self.dimensions.sensor_to_cg
        given = self._before.copy().set(keys.VELOCITY, shift_velocity(at_cg, arm))
        after = self.container.base_env._step(given)  # type: ignore[union-attr]
        return shift_velocity(after[keys.VELOCITY], -arm)

    def _change_and_state(self, motion: Motion) -> tuple[Tensor, Tensor]:
        assert motion.state is not None
        car = FrictionChange.of(self._tensor("numbers"), slice(*self._axles))
        ratio = torch.stack([r.expand_as(motion.turn_rate) for r in self._ratios(motion)])
        ax, ay, _ = motion.acceleration
        resists = car._resistance(motion)
        circle = car._load(ax + resists) * car.friction
        seen = car._axle_forces(motion, motion.acceleration, circle[0], resists)
        lost = (car.speed_loss[0] + car.speed_loss[1] * motion.drive).clamp_min(0.0)
        drive, slide = car.combined * seen.drive, car._slide(motion, seen.angle)
        along, left, left_now, spin = car.driven.changed(
            motion.state.movedim(-1, 0), drive, lost, circle, ratio, slide
        )
        ratio = ratio * left_now / left
        start = _scaled(car, motion.before, ratio, seen.angle, self.dt)
        second = replace(motion, before=start, after=self._stepped(start))
        now = ratio * _side(car, second, seen.drive, seen.angle)

        front, rear = (now - seen.side).unbind()
        turned = torch.stack([torch.cos(seen.angle), torch.ones_like(front)])
        gained = (along * turned).sum(0) - front * torch.tan(seen.angle)
        front = front + along[0] * torch.sin(seen.angle)
        couple = car._couple(ay + front + rear, now[0], seen.angle)
        moment = car.front_arm * front - car.rear_arm * rear - (couple - seen.couple)
        yaw = car.mass / car.yaw_inertia * moment
        return self.dt * torch.stack([gained, front + rear, yaw], -1), spin.movedim(0, -1)


def _scaled(car: FrictionChange, at_cg: Tensor, ratio: Tensor, angle: Tensor, dt: float) -> Tensor:
    """The velocity [n, 3] of the second step."""
    vx, vy, yaw_rate = at_cg.unbind(-1)
    across = torch.stack([vy + car.front_arm * yaw_rate, vy - car.rear_arm * yaw_rate])
    rolls = _in_front(vx * torch.tan(angle))
    across = rolls + (across - rolls) / ratio
    turning = (across[0] - across[1]) / car.wheelbase
    drift = vx * (turning - yaw_rate / ratio)
    across = across + 0.5 * dt * drift
    turning = (across[0] - across[1]) / car.wheelbase
    return torch.stack([vx, across[1] + car.rear_arm * turning, turning], -1)


def _side(car: FrictionChange, motion: Motion, drive: Tensor, angle: Tensor) -> Tensor:
    """Side forces [2, n] of both axles, means of the second step."""
    _, ay, yaw = motion.acceleration
    couple = torch.zeros_like(ay)
    side = car.share * ay
    for _ in range(2):
        moment = (car.yaw_inertia / car.mass * yaw + couple) / car.wheelbase
        side = car.share * ay + torch.stack([moment, -moment])
        side = side - _in_front(car._drive_side(drive, angle))
        couple = car._couple(ay, side[0], angle)
    return side
