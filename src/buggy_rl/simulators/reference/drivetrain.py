"""Drivetrain, throttle to tread: battery, speed controller, DC motor, open differential, wheels.

Spins are kept as tread speeds u = R omega [m/s] and inertias as masses at the tread J / R^2 [kg].
"""

from collections.abc import Mapping

import torch
from torch import Tensor

from buggy_rl.core.vehicle import GRAVITY
from buggy_rl.simulators.reference.chassis import Chassis
from buggy_rl.simulators.reference.faults import Faults
from buggy_rl.simulators.reference.state import HEAT, LEFT_CURRENT, THROTTLE_LAG, CarState, Setting
from buggy_rl.simulators.reference.steering import SHORTEST, SecondOrderLag

KNEE = 12  # [-] exponent of the knee: half of it is in the last 6 % of the charge; chosen
DRIVEN_CURRENT = 2.15  # [A] mean of the buggy's battery in 64 drives of 20 s by the room driver
COOLING = 30.0  # [s] time constant of the winding's cooling to the can; chosen
DRAGGED = 0.1  # [-] share of a bent axle's moment that is drag of a front wheel; chosen
ROLLING_SPEED = 0.1  # [m/s] speed at which a buggy's bent axle binds with tanh(1) = 76 %; chosen
NO_LOAD = 1e-3  # [N] least load of an axle under a fraction
CRAWL = 0.05  # [m/s] least speed of a buggy's power limit; chosen


class Drivetrain:
    """Battery, motor and the four wheels' spin.

    Args:
        values: Parameter name -> value, each [*] or ones in place of the batch.
        wheel_radius: [m].
        chassis: Of the car.
        faults: Of controller, battery, motor and wheels.
        dt: Substep [s].
    """

    def __init__(
        self,
        values: Mapping[str, Tensor],
        wheel_radius: float,
        chassis: Chassis,
        faults: Faults | None = None,
        dt: float = 1e-3,
    ) -> None:
        faults = faults or Faults({}, values["mass"])
        self.values, self.faults = values, faults
        scale = chassis.similarity
        self.crawl, self.rolls = scale.speed * CRAWL, scale.speed * ROLLING_SPEED
        self.driven_current = scale.of("A") * DRIVEN_CURRENT
        turns = values["gear_ratio"] * faults["gear_ratio.ratio"]
        gear = turns / wheel_radius  # [1/m] motor angle over way at the tread
        # Fewer turns of a thicker wire: less back-EMF, torque and resistance; the same stall force.
        winding = faults["top_speed.speed_ratio"]
        self.motor_constant = values["motor_constant"] * gear / winding  # [V s/m] = [N/A]
        self.motor_resistance = values["motor_resistance"] / winding
        worn = faults["voltage_sag.resistance_ratio"] * self.motor_resistance
        self.battery_resistance = values["battery_resistance"] + worn
        self.slew = values["throttle_slew"]  # [1/s]
        self.wheel_mass = values["wheel_inertia"] / wheel_radius**2
        self.axle_mass = 2.0 * self.wheel_mass + values["rotor_inertia"] * gear.square()

        spare = values["throttle_deadband"]
        self.deadband = spare + (1.0 - spare) * faults["throttle_deadband.width"]
        self.power = faults["motor_power_limit.power_per_mass"] * values["mass"]
        self.lag = SecondOrderLag(faults["throttle_lag.time_constant"], dt)
        left = faults["loose_differential.time_constant"]
        self.tight, self.winding_up = left <= 0, -torch.expm1(-dt / left.clamp_min(SHORTEST))

        # Resistance at the wheels decelerates car and wheels together.
        self.rolling_mass = chassis.mass + 2.0 * self.wheel_mass + self.axle_mass
        share = self.rolling_mass / chassis.mass
        slowing = faults["rolling_resistance.deceleration"] * share / GRAVITY
        self.rolling = values["rolling_resistance"] + slowing
        self.scrub = faults["cornering_drag.coefficient"] * share * GRAVITY
        self.turned_drag = faults["steering_drag.per_angle"] * self.rolling_mass  # [N/rad]
        self.beside = faults["torque_steer.offset"] / chassis.wheel_y[0]
        stiff = faults["stiff_differential.coupling"]
        self.locking = stiff / (1.0 - stiff) * values["longitudinal_stiffness"]
        self.bearing = 0.25 * faults["viscous_drag.rate"] * self.rolling_mass  # [N s/m] a wheel
        self.axle_viscosity = values["gear_viscosity"] + 2.0 * self.bearing
        self.half_viscosity = values["differential_viscosity"] + self.bearing
        # Force at the half track: drag of a front wheel, the rest a difference of the rear wheels'.
        moment = faults["one_sided_drag.yaw_acceleration"] * chassis.yaw_inertia
        force = moment / chassis.wheel_y[0]  # [N]
        dragging = DRAGGED * force
        self.dragging = torch.stack([dragging.clamp_min(0.0), (-dragging).clamp_min(0.0)])  # (2, *)
        self.binding = 0.5 * (1.0 - DRAGGED) * force

    def open_voltage(self, charge: Tensor) -> Tensor:
        """Open-circuit voltage [*] after `charge` [*] [A s] was taken out since full.

        V = V_full - a q - b q^12,  q = charge / capacity. A worn battery loses more, in
        proportion to the charge taken out since the start.
        """
        values = self.values
        used = (charge / values["capacity"]).clamp(0.0, 1.0)
        voltage = (
            values["full_voltage"]
            - values["voltage_drop"] * used
            - values["knee_drop"] * used**KNEE
        )
        if "battery_sag" not in self.faults:
            return voltage
        taken = charge - (1.0 - values["initial_charge"]) * values["capacity"]
        lost = self.faults["battery_sag.loss_per_minute"] * taken / (60.0 * self.driven_current)
        return voltage * (1.0 - lost).clamp_min(0.0)

    def filtered(self, fault_state: dict[str, Tensor], throttle: Tensor) -> Tensor:
        """Throttle [*] behind the speed controller's lag, after a step."""
        fault_state[THROTTLE_LAG] = self.lag.moved(fault_state[THROTTLE_LAG], throttle)
        return fault_state[THROTTLE_LAG][1]

    def target_duty(self, throttle: Tensor) -> Tensor:
        """Duty cycle [*] for a throttle [*] in [-1, 1]; 0 inside the deadband."""
        drive = 0.5 * (throttle + 1.0)
        duty = ((drive - self.deadband) / (1.0 - self.deadband)).clamp_min(0.0)
        if "throttle_gain" in self.faults:  # above 1 a higher voltage
            duty = duty * self.faults["throttle_gain.gain"]
        return duty

    def throttle_at(self, duty: Tensor) -> Tensor:
        """Throttle [*] for a duty cycle [*]; -1 for 0."""
        drive = self.deadband + (1.0 - self.deadband) * duty / self.faults["throttle_gain.gain"]
        return torch.where(duty > 0, 2.0 * drive.clamp_max(1.0) - 1.0, -1.0)

    def slewed(self, duty: Tensor, target: Tensor, dt: float) -> Tensor:
        """Duty cycle [*] after a step towards its target, no faster than the slew allows."""
        step = self.slew * dt
        return duty + torch.clamp(target - duty, -step, step)

    def current(
        self, duty: Tensor, axle_speed: Tensor, voltage: Tensor, heat: Tensor | None = None
    ) -> Tensor:
        """Motor current [*] [A] at a tread speed [*] [m/s] and an open-circuit voltage [*] [V].

        The controller is a transformer: V_motor = d (V - R_b d i), i_battery = d i, thus
        i = (d V - k u) / (R_m + d^2 R_b). It freewheels: a negative current does not flow. `heat`
        [*] [J] in the winding raises R_m.
        """
        winding = self.motor_resistance
        if heat is not None:
            winding = winding * (1.0 + self.faults["heating_motor.rise"] * heat)
        resistance = winding + duty.square() * self.battery_resistance
        current = (duty * voltage - self.motor_constant * axle_speed) / resistance
        if "motor_power_limit" in self.faults:  # k i u is what arrives at the shaft
            limit = self.power / (self.motor_constant * axle_speed.clamp_min(self.crawl))
            current = torch.minimum(current, limit)
        if "drag_brake" in self.faults:
            return torch.maximum(current, self.faults["drag_brake.share"] * current)
        return current.clamp_min(0.0)

    def motor(
        self, asked: Tensor, car: CarState, setting: Setting, heat: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        """Duty cycle [*] at the motor, of the one asked for [*], and its current [*] [A]."""
        axle_speed = 0.5 * (car.tread[2] + car.tread[3])
        return asked, self.current(asked, axle_speed, setting.voltage, heat)

    def brakes(self, duty: Tensor, target: Tensor, car: CarState) -> tuple[Tensor, Tensor] | None:
        """Brake force [N] of the front axle [*] and of the rear one [*]; None without brakes."""
        del duty, target, car

    def warmed(self, fault_state: dict[str, Tensor], current: Tensor, dt: float) -> None:
        """Heat of the winding: dQ/dt = R_m i^2 - Q / tau."""
        loss = self.motor_resistance * current.square() - fault_state[HEAT] / COOLING
        fault_state[HEAT] = fault_state[HEAT] + dt * loss

    def drained(self, charge: Tensor, duty: Tensor, current: Tensor, dt: float) -> Tensor:
        """Charge [*] [A s] taken out of the battery after a step."""
        return charge + dt * (duty * current + self.values["electronics_current"])

    def freewheeling_duty(self, speed: Tensor, voltage: Tensor) -> Tensor:
        """Duty cycle [*] at which no current flows at this speed [*] [m/s]."""
        return (self.motor_constant * speed / voltage).clamp(0.0, 1.0)

    def spun(
        self,
        tread: Tensor,
        ground_force: Tensor,
        load: Tensor,
        current: Tensor,
        dt: float,
        twist: Tensor | None = None,
        brakes: tuple[Tensor, Tensor] | None = None,
        angle: Tensor | None = None,
    ) -> Tensor:
        """Tread speeds [4, *] [m/s] after a step.

        m_w du/dt = -F - f sign(u) for the free front wheels. The rear wheels share the motor
        through an open differential: their mean carries rotor, gear and motor force, half their
        difference only the wheels. Dry friction f stops a wheel but never turns it.

        Args:
            tread: [4, *] before the step.
            ground_force: [2, 4, *] force of the ground on each tyre, along and across [N].
            load: [4, *] normal load [N].
            current: [*] motor current [A].
            dt: Step [s].
            twist: [*] motor current that the left half of the axle gets in excess of its share.
            brakes: [*] force of the front and of the rear brakes [N], which stop but never turn.
            angle: [*] of the front wheels [rad], whose joints drag the more they are turned.
        """
        along, across = ground_force
        rolling = self.rolling * load * dt  # (4, *) momentum dry friction can take
        if "cornering_drag" in self.faults:
            # Of an axle c F^2 over its share of the mass, N / g.
            use = shared(across, load) / load.clamp_min(NO_LOAD)
            rolling = rolling + self.scrub * dt * load * use.square()
        held = rolling[:2] + self.dragging * dt if "one_sided_drag" in self.faults else rolling[:2]
        if brakes is not None:
            held = held + 0.5 * brakes[0] * dt
        if angle is not None:
            held = held + 0.5 * self.turned_drag * angle.abs() * dt
        front = tread[:2] - along[:2] * (dt / self.wheel_mass)
        if "viscous_drag" in self.faults:
            front = front / (1.0 + self.bearing * dt / self.wheel_mass)
        front = stopped(front, held / self.wheel_mass)

        left, right = tread[2:]
        force_left, force_right = along[2:]
        motor = self.motor_constant * current
        mean = 0.5 * (left + right)
        mean = mean + (motor - force_left - force_right) * (dt / self.axle_mass)
        mean = mean / (1.0 + self.axle_viscosity * dt / self.axle_mass)
        dry = rolling[2] + rolling[3] + self.values["gear_friction"] * dt
        if brakes is not None:
            dry = dry + brakes[1] * dt
        mean = stopped(mean, dry / self.axle_mass)

        half = 0.5 * (left - right) - 0.5 * (force_left - force_right) * (dt / self.wheel_mass)
        if "one_sided_drag" in self.faults:
            half = half - self.binding * torch.tanh(mean / self.rolls) * (dt / self.wheel_mass)
        if twist is not None:
            half = half + 0.5 * self.motor_constant * twist * (dt / self.wheel_mass)
        viscosity = self.half_viscosity
        if "stiff_differential" in self.faults:
            # In series with the tyres' own slip, K = C N / v: a share of what a locked axle has.
            held_by = self.locking * 0.5 * (load[2] + load[3])
            viscosity = viscosity + held_by / mean.abs().clamp_min(self.rolls)
        half = half / (1.0 + viscosity * dt / self.wheel_mass)
        return torch.cat([front, torch.stack([mean + half, mean - half])])

    def twisted(self, fault_state: dict[str, Tensor], current: Tensor) -> Tensor:
        """Current [*] of the left half above its share, behind the lag of a loose differential."""
        late = fault_state[LEFT_CURRENT].squeeze(0)
        late = torch.where(self.tight, current, late + self.winding_up * (current - late))
        fault_state[LEFT_CURRENT] = late.unsqueeze(0)
        return late - current


def shared(force: Tensor, load: Tensor) -> Tensor:
    """Absolute force of each axle, shared by load [4, *] between its wheels [4, *]."""
    sides = force.unflatten(0, (2, 2)).sum(1), load.unflatten(0, (2, 2)).sum(1)  # (2, *) an axle
    friction = sides[0].abs() / sides[1].clamp_min(NO_LOAD)
    return load * friction.repeat_interleave(2, 0)


def stopped(speed: Tensor, reach: Tensor) -> Tensor:
    """Reduces the size of a speed by at most `reach`, not below 0: dry friction."""
    return speed - torch.clamp(speed, -reach, reach)
