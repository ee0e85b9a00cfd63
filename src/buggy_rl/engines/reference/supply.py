"""A supply that gives way: to a steering servo that draws current, and to heat."""

import torch
from torch import Tensor

from buggy_rl.engines.reference.faults import Faults
from buggy_rl.engines.reference.state import SUPPLY_HEAT
from buggy_rl.longitudinal import LongitudinalCommand, drive_of

SERVO_SPEED = 5.0  # [1/s] of a servo that draws its largest current: under half of its fastest


class Supply:
    """What is left of the duty cycle; all of it without a fault.

    Args:
        faults: Of servo supply and controller.
        command: What the first command is.
        dt: Substep [s].
    """

    def __init__(self, faults: Faults, command: LongitudinalCommand, dt: float) -> None:
        self.faults, self.rest, self.dt = faults, command.rest, dt
        self.weak = "brown_out" in faults or "thermal_foldback" in faults

    def left(
        self,
        fault_state: dict[str, Tensor],
        duty: Tensor,
        throttle: Tensor,
        before: Tensor,
        servo: Tensor,
    ) -> Tensor:
        """Duty cycle [*] at the motor, of the one that the controller makes [*].

        Args:
            fault_state: Holds the heat, which is moved on.
            duty: [*], of either sign; a brake is not weakened.
            throttle: [*] command, whose square heats.
            before: [*] position of the servo before the step.
            servo: [*] after it.
        """
        left = torch.ones_like(duty)
        if "brown_out" in self.faults:
            fast = ((servo - before).abs() / (self.dt * SERVO_SPEED)).clamp_max(1.0)
            drawn = self.faults["brown_out.moving"] * fast
            left = left - drawn - self.faults["brown_out.holding"] * servo.abs()
        if "thermal_foldback" in self.faults:
            heat = fault_state[SUPPLY_HEAT].squeeze(0)
            left = left * (1.0 - self.faults["thermal_foldback.foldback"] * heat)
            work = drive_of(throttle, self.rest).clamp(-1.0, 1.0).square()
            rate = self.dt / self.faults["thermal_foldback.time_constant"]
            fault_state[SUPPLY_HEAT] = (heat + rate * (work - heat)).unsqueeze(0)
        return torch.where(duty > 0, duty * left.clamp_min(0.0), duty)
