"""One buggy in the equations of `commonroad-vehicle-models`: its drift single-track car (STD).

The library's function is called unchanged. Its inputs are the buggy's motor, friction and servo;
forces of air and floor, which it lacks, are added to its output, and two corrections:

- Below 0.2 m/s the library blends to a kinematic car, but yaw rate and sideslip drift: they are
  drawn to the kinematic ones, with the time constant with which the library draws the wheels.
- Past 90 degrees of sideslip its slip angles change sign and a spin gains energy: from 70 to 85
  degrees its tyres are replaced by two axles that slide on dry friction.
"""

import math
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from buggy_rl.core.vehicle import GRAVITY, VehicleDimensions
from buggy_rl.proof.plants.faults import PlantFaults
from buggy_rl.proof.plants.mechanics import PUSHES, patch_grip, push, turned_back

STATES = 9  # x, y, steering angle, speed, yaw, yaw rate, sideslip angle, wheel speeds
STEERING, SPEED, YAW, YAW_RATE, SIDESLIP, FRONT_WHEEL, REAR_WHEEL = range(2, STATES)
STIFF = [YAW_RATE, SIDESLIP, FRONT_WHEEL, REAR_WHEEL]
NUDGE = 1e-6  # step of the finite differences by the stiff states
GAMMA = 1.0 - 1.0 / math.sqrt(2.0)  # of ROS2, which is then L-stable; Verwer et al. 1999

# Constants in the library's function: speed and width of the blend, least speed, time constant.
BLEND_SPEED, BLEND_WIDTH, SLOWEST, DRAWN_IN = 0.2, 0.05, 0.1, 0.02  # [m/s] three times, [s]
STOPPING_SPEED = 0.1  # [m/s] speed at which friction is at tanh(1) = 76 %; chosen
SPUN = (
    math.radians(70.0),
    math.radians(85.0),
)  # [rad] sideslip over which the tyres are replaced; chosen
CREEP = 0.1  # [m/s] speed below which a sliding axle has less than its friction; chosen
STANDING = 1e-3  # [m/s] speed below which the sideslip angle is undefined
SLOWEST_SHAFT = 0.05  # [m/s] least tread speed of the power limit; chosen
UNBOUND = 1e3  # [m/s^2], [m/s], [rad/s] limits of the library, out of reach
PAYLOAD_RADIUS = 0.05  # [m] radius of gyration of the payload; chosen
REAR_BRAKING = 0.7  # [-] share of the friction in motor and gear, at the rear wheels; chosen
WHEEL_INERTIA = 1.0e-4  # [kg m^2] an axle: two wheels of 40 g and a share of the rotor; chosen


@cache
def library() -> Any:
    """The library's STD function and the parameters of its second car.

    Raises:
        ModuleNotFoundError: It is not installed.
    """
    try:
        from vehiclemodels.parameters_vehicle2 import parameters_vehicle2
        from vehiclemodels.vehicle_dynamics_std import vehicle_dynamics_std
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "the commonroad plant needs the library commonroad-vehicle-models: "
            "pip install 'buggy_rl[proof]', or pip install 'commonroad-vehicle-models>=3.0.2'"
        ) from error
    return vehicle_dynamics_std, parameters_vehicle2


class CommonroadCar:
    """One car: parameters in the library's form, its right-hand side, one step of it.

    Args:
        values: Parameters of the plant by name.
        faults: Of the car.
        h: Step [s].
    """

    def __init__(self, values: Mapping[str, float], faults: PlantFaults, h: float) -> None:
        self.faults, self.values, self.h = faults, values, h
        self._equations, parameters = library()
        self.p = parameters()
        self.radius = VehicleDimensions.wheel_radius
        self.bare_mass = values["mass"]
        self._scale_body()
        self._scale_limits()
        self._scale_tyres()
        wheels = 2.0 * WHEEL_INERTIA / self.radius**2  # [kg]
        self.rolling_share = 1.0 + wheels / self.p.m
        self._pushes = bool((PUSHES | {"floor_slope", "torque_steer"}) & faults.active)
        self._turns = bool({"understeer", "dive_steer"} & faults.active)
        self._slope = (faults["floor_slope.along_x"], faults["floor_slope.along_y"])
        half_track = 0.5 * VehicleDimensions.track_width
        rear_load = self.p.m * GRAVITY * self.p.a / (self.p.a + self.p.b)
        self._pushed = push(faults, self.rolling_share, self.p.m, self.p.I_z, half_track, rear_load)

    def _scale_body(self) -> None:
        p, values, dimensions = self.p, self.values, VehicleDimensions()
        load = values["mass"] * (self.faults["payload.mass_ratio"] - 1.0)
        p.m = values["mass"] + load
        p.I_z = values["yaw_inertia"] + load * PAYLOAD_RADIUS**2
        p.a = values["cg_to_front_axle"]
        p.b = dimensions.wheelbase - p.a
        p.h_s = dimensions.cg_height
        p.R_w, p.I_y_w = self.radius, WHEEL_INERTIA
        p.T_sb, p.T_se = 1.0 - REAR_BRAKING, 0.0

    def _scale_limits(self) -> None:
        p, lock = self.p, self.values["steering_lock"]
        fastest = self.values["steering_rate"]
        p.steering.v_max, p.steering.v_min = fastest * lock, -fastest * lock
        p.steering.max, p.steering.min = math.pi / 2, -math.pi / 2  # the linkage limits the angle
        p.longitudinal.a_max, p.longitudinal.v_switch = UNBOUND, UNBOUND
        p.longitudinal.v_max, p.longitudinal.v_min = UNBOUND, -UNBOUND

    def _scale_tyres(self) -> None:
        """Peaks and slopes are the buggy's; the shape factors stay those of the library's tyre.

        Combined-slip factors are in proportion to slip over peak slip, K s / D. Shifts and ply
        steer, which steer a car to one side, are left out.
        """
        t, values = self.p.tire, self.values
        for name in ("p_hx1", "p_vx1", "r_hx1", "r_hy1", "r_by3", "r_vy1", "r_vy3"):
            setattr(t, name, 0.0)
        peak = values["grip"] * self.faults["tire_grip.grip"]
        along = values["slip_stiffness"] / peak / (t.p_kx1 / t.p_dx1)
        stiffness = values["cornering_stiffness"] * self.faults["cornering_stiffness.ratio"]
        across = stiffness / peak / (-t.p_ky1 / t.p_dy1)
        t.r_bx1, t.r_bx2 = t.r_bx1 * across, t.r_bx2 * along
        t.r_by1, t.r_by2 = t.r_by1 * along, t.r_by2 * across
        t.p_kx1, t.p_ky1 = values["slip_stiffness"], -stiffness
        t.p_dx1 = t.p_dy1 = self.peak = peak

    def moved(self, state: NDArray, duty: float, steering_rate: float) -> NDArray:
        """State [9] a step on, by ROS2 (Verwer): of second order with any matrix A, L-stable.

        (1 - g h A) k1 = f(y),  (1 - g h A) k2 = f(y + h k1) - 2 k1,  y' = y + h (3 k1 + k2) / 2,
        with A the derivatives by the stiff states.

        Args:
            state: [9].
            duty: Of the motor, in 0..1.
            steering_rate: That the servo asks for [rad/s].
        """
        if "grip_patch" in self.faults:
            grip = self.peak * float(patch_grip(self.faults, state[0], state[1]))
            self.p.tire.p_dx1 = self.p.tire.p_dy1 = grip
        slope = self.rates(state, duty, steering_rate)
        matrix = np.eye(STATES)
        for index in STIFF:
            nudged = state.copy()
            nudged[index] += NUDGE
            change = (self.rates(nudged, duty, steering_rate) - slope) / NUDGE
            matrix[:, index] -= GAMMA * self.h * change
        inverse = np.linalg.inv(matrix)
        first = inverse @ slope
        second = inverse @ (self.rates(state + self.h * first, duty, steering_rate) - 2.0 * first)
        state = state + self.h * (1.5 * first + 0.5 * second)
        state[FRONT_WHEEL:] = np.maximum(state[FRONT_WHEEL:], 0.0)  # the library's, too
        return state

    def rates(self, state: NDArray, duty: float, steering_rate: float) -> NDArray:
        """Derivatives [9] of the state: the library's with corrections and added forces."""
        x = state.tolist()
        motor = self.motor_force(duty, x[REAR_WHEEL] * self.radius)
        force = motor - self.friction(x)
        x[STEERING] += self._turned(x, force)
        rates = np.array(self._equations(x, [steering_rate, force / self.p.m], self.p))
        speed, slip = x[SPEED], x[SIDESLIP]
        dynamic = 0.5 * (math.tanh((speed - BLEND_SPEED) / BLEND_WIDTH) + 1.0)
        if dynamic < 1.0 - 1e-9:
            held = (1.0 - dynamic) / DRAWN_IN
            kinematic = self.kinematic_sideslip(x[STEERING])
            turning = speed * math.cos(kinematic) * math.tan(x[STEERING]) / (self.p.a + self.p.b)
            rates[YAW_RATE] += held * (turning - x[YAW_RATE])
            rates[SIDESLIP] += held * (kinematic - slip)
        spun = (abs(slip) - SPUN[0]) / (SPUN[1] - SPUN[0])
        if spun > 0.0 and speed > 0.0:
            rates += min(spun, 1.0) * (self.sliding_rates(x, rates) - rates)
        if self._pushes:
            ax, ay, turning = self._push(x)
            turning -= self.faults["torque_steer.offset"] * motor / self.p.I_z
            cos, sin = math.cos(slip), math.sin(slip)
            rates[SPEED] += ax * cos + ay * sin
            rates[SIDESLIP] += dynamic * (ay * cos - ax * sin) / max(speed, SLOWEST)
            rates[YAW_RATE] += dynamic * turning
        return rates

    def sliding_rates(self, x: list[float], rates: NDArray) -> NDArray:
        """Derivatives [9] of a car whose axles slide: F = -mu F_z u / |u|, u an axle's velocity."""
        p, speed, slip, yaw_rate = self.p, x[SPEED], x[SIDESLIP], x[YAW_RATE]
        vx, vy = speed * math.cos(slip), speed * math.sin(slip)
        ax = ay = turning = 0.0
        for arm, other in ((p.a, p.b), (-p.b, p.a)):
            across = vy + arm * yaw_rate
            held = p.tire.p_dy1 * GRAVITY * other / (p.a + p.b) / (math.hypot(vx, across) + CREEP)
            ax, ay = ax - held * vx, ay - held * across
            turning -= held * across * arm * p.m / p.I_z
        change = (ay * math.cos(slip) - ax * math.sin(slip)) / max(speed, SLOWEST)
        rates = rates.copy()  # way and steering are the library's
        rates[SPEED], rates[YAW] = ax * math.cos(slip) + ay * math.sin(slip), yaw_rate
        rates[YAW_RATE], rates[SIDESLIP] = turning, change - yaw_rate
        rates[FRONT_WHEEL:] = (max(vx, 0.0) / self.radius - np.array(x[FRONT_WHEEL:])) / DRAWN_IN
        return rates

    def kinematic_sideslip(self, angle: float) -> float:
        """Sideslip angle [rad] at the centre of gravity of a car that rolls without slip."""
        return math.atan(math.tan(angle) * self.p.b / (self.p.a + self.p.b))

    def _turned(self, x: list[float], force: float) -> float:
        """Angle [rad] of the front wheels beside the servo's, at a force along the car [N]."""
        if not self._turns:
            return 0.0
        forward = force / (self.p.m * self.rolling_share)
        vx = x[SPEED] * math.cos(x[SIDESLIP])
        return turned_back(self.faults, vx, x[YAW_RATE], forward)

    def motor_force(self, duty: float, tread: float) -> float:
        """Force [N] of the motor: F = d (F0 - c u / r), not more than P / u."""
        gear = self.faults["gear_ratio.ratio"]
        loss = gear * self.values["drive_speed_loss"] / self.faults["top_speed.speed_ratio"]
        force = duty * gear * max(self.values["drive_force"] - loss * tread, 0.0)
        if "motor_power_limit" in self.faults:
            power = self.faults["motor_power_limit.power_per_mass"] * self.bare_mass
            force = min(force, power / max(tread, SLOWEST_SHAFT))
        return force

    def friction(self, x: list[float]) -> float:
        """Force [N] against the rolling: (F_d + m a_d) tanh(v / v_s) + (c + m b) v + k v |v|."""
        faults, values, speed = self.faults, self.values, x[SPEED]
        heavy = self.p.m * self.rolling_share
        dry = values["rolling_resistance"] + heavy * faults["rolling_resistance.deceleration"]
        # Tyres push sideways by m v r in a steady turn.
        dry += heavy * faults["cornering_drag.coefficient"] * (speed * x[YAW_RATE]) ** 2
        dry += heavy * faults["steering_drag.per_angle"] * abs(x[STEERING])
        viscous = values["viscous_drag"] + heavy * faults["viscous_drag.rate"]
        rolling = dry * math.tanh(speed / STOPPING_SPEED)
        return rolling + (viscous + values["quadratic_drag"] * abs(speed)) * speed

    def _push(self, x: list[float]) -> tuple[float, float, float]:
        speed, slip, yaw = x[SPEED], x[SIDESLIP], x[YAW]
        cos, sin = math.cos(yaw), math.sin(yaw)
        vx, vy = speed * math.cos(slip), speed * math.sin(slip)
        ax, ay, turning = self._pushed(cos, sin, vx, vy, x[YAW_RATE])
        along, across = self._slope
        return (
            float(ax) + cos * along + sin * across,
            float(ay) + cos * across - sin * along,
            float(turning),
        )
