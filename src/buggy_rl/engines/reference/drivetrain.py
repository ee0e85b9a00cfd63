"""From throttle to tread: battery, speed controller, DC motor, open differential, wheels.

Spins are kept as tread speeds u = R omega [m/s] and inertias as masses at the tread J / R^2 [kg].
"""

from collections.abc import Mapping

import torch
from torch import Tensor

KNEE = 12  # steepness of the end of discharge: half of the knee is in the last 6 % of the charge


class Drivetrain:
    """Battery, motor and the four wheels' spin.

    Args:
        values: Parameter name -> value, each [*] or ones in place of the batch.
        wheel_radius: [m].
    """

    def __init__(self, values: Mapping[str, Tensor], wheel_radius: float) -> None:
        self.values = values
        gear = values["gear_ratio"] / wheel_radius  # [1/m] motor angle over way at the tread
        self.motor_constant = values["motor_constant"] * gear  # [V s/m] = [N/A]
        self.wheel_mass = values["wheel_inertia"] / wheel_radius**2
        self.axle_mass = 2.0 * self.wheel_mass + values["rotor_inertia"] * gear.square()

    def open_voltage(self, charge: Tensor) -> Tensor:
        """Open-circuit voltage [*] after `charge` [*] [A s] was taken out since full.

        V = V_full - a q - b q^12,  q = charge / capacity.
        """
        values = self.values
        used = (charge / values["capacity"]).clamp(0.0, 1.0)
        return (
            values["full_voltage"]
            - values["voltage_drop"] * used
            - values["knee_drop"] * used**KNEE
        )

    def target_duty(self, throttle: Tensor) -> Tensor:
        """Duty cycle [*] asked for by `throttle` [*] in [-1, 1]: nothing inside the deadband."""
        deadband = self.values["throttle_deadband"]
        drive = 0.5 * (throttle + 1.0)
        return ((drive - deadband) / (1.0 - deadband)).clamp(0.0, 1.0)

    def slewed(self, duty: Tensor, target: Tensor, dt: float) -> Tensor:
        """Duty cycle [*] after a step towards its target, no faster than the slew allows."""
        step = self.values["throttle_slew"] * dt
        return duty + torch.clamp(target - duty, -step, step)

    def current(self, duty: Tensor, axle_speed: Tensor, voltage: Tensor) -> Tensor:
        """Motor current [*] [A] at a tread speed [*] [m/s] and an open-circuit voltage [*] [V].

        The controller is a transformer: V_motor = d (V - R_b d i), i_battery = d i, thus
        i = (d V - k u) / (R_m + d^2 R_b). A negative current is let through by `drag_brake` only.
        """
        values = self.values
        resistance = values["motor_resistance"] + duty.square() * values["battery_resistance"]
        current = (duty * voltage - self.motor_constant * axle_speed) / resistance
        return torch.maximum(current, values["drag_brake"] * current)

    def drained(self, charge: Tensor, duty: Tensor, current: Tensor, dt: float) -> Tensor:
        """Charge [*] [A s] taken out of the battery after a step."""
        return charge + dt * (duty * current + self.values["electronics_current"])

    def freewheeling_duty(self, speed: Tensor, voltage: Tensor) -> Tensor:
        """Duty cycle [*] at which no current flows at this speed [*] [m/s]."""
        return (self.motor_constant * speed / voltage).clamp(0.0, 1.0)

    def spun(
        self, tread: Tensor, ground_force: Tensor, load: Tensor, current: Tensor, dt: float
    ) -> Tensor:
        """Tread speeds [4, *] [m/s] after a step.

        m_w du/dt = -F - f sign(u) for the free front wheels. The rear wheels share the motor
        through an open differential: their mean carries rotor, gear and motor force, half their
        difference only the wheels. Dry friction f stops a wheel but never turns it.

        Args:
            tread: [4, *] before the step.
            ground_force: [4, *] longitudinal force of the ground on each tyre [N].
            load: [4, *] normal load [N].
            current: [*] motor current [A].
            dt: Step [s].
        """
        values = self.values
        rolling = values["rolling_resistance"] * load * dt  # (4, *) momentum dry friction can take
        front = tread[:2] - ground_force[:2] * (dt / self.wheel_mass)
        front = stopped(front, rolling[:2] / self.wheel_mass)

        left, right = tread[2:]
        force_left, force_right = ground_force[2:]
        motor = self.motor_constant * current
        mean = 0.5 * (left + right)
        mean = mean + (motor - force_left - force_right) * (dt / self.axle_mass)
        mean = mean / (1.0 + values["gear_viscosity"] * dt / self.axle_mass)
        dry = rolling[2] + rolling[3] + values["gear_friction"] * dt
        mean = stopped(mean, dry / self.axle_mass)

        half = 0.5 * (left - right) - 0.5 * (force_left - force_right) * (dt / self.wheel_mass)
        half = half / (1.0 + values["differential_viscosity"] * dt / self.wheel_mass)
        return torch.cat([front, torch.stack([mean + half, mean - half])])


def stopped(speed: Tensor, reach: Tensor) -> Tensor:
    """Takes at most `reach` off the size of a speed, so that dry friction ends at zero."""
    return speed - torch.clamp(speed, -reach, reach)
