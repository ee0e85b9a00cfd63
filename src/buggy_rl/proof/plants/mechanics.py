"""Faults of servo, speed controller and surroundings that several plants share.

Stages of the steering in series: dead centre, lag, stiction, rate limit, play, bent linkage, its
gains, end stop. Of the drive: lag, deadband, gain, battery and its resistance, heat, what the servo
takes. Arrays are [n] over environments, commands in [-1, 1].
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from buggy_rl.proof.plants.faults import PlantFaults

# Columns of the memory, with their values at rest.
RESTING = {
    **{"smoothed": 0.0, "servo": 0.0, "rack": 0.0, "throttle": -1.0, "minutes": 0.0},
    **{"held": 0.0, "going": 0.0, "horn": 0.0, "horn_speed": 0.0, "heat": 0.0},
}
(
    SMOOTHED, SERVO, RACK, THROTTLE, MINUTES, HELD, GOING, HORN, HORN_SPEED, HEAT
) = range(len(RESTING))  # fmt: skip
STAGES = frozenset(
    (
        "steering_lag", "steering_rate_limit", "steering_backlash", "steering_gain",
        "steering_asymmetry", "throttle_lag", "throttle_deadband", "throttle_gain", "battery_sag",
        "servo_stiction", "steering_dead_zone", "steering_curve", "steering_end_stop",
        "steering_play", "voltage_sag", "thermal_foldback", "brown_out",
    )
)  # fmt: skip
LET_GO = 0.1  # [-] share of the width at which a sticking servo rests again; chosen
PUSHED = 0.6  # [m/s^2] lateral acceleration at which the tyres have taken up half the play; chosen
DRAWN_AT = 5.0  # [1/s] speed of a servo that draws all it can
ELECTRONICS = 0.3  # [-] share of computer and camera in the mean battery current; chosen


class Mechanics:
    """The stages of all environments; a stage without a fault passes its input.

    Args:
        faults: Of the stages.
        h: Step [s].
        typical: Mean force [N] of the plant's motor in room drives, by which charge is counted in
            minutes of driving.
    """

    def __init__(self, faults: PlantFaults, h: float, typical: float) -> None:
        self.faults, self.h, self.typical = faults, h, typical
        self.active = bool(STAGES & faults.active)
        self._kept = {
            name: float(np.exp(-h / max(faults[f"{name}.time_constant"], 1e-9)))
            for name in ("steering_lag", "throttle_lag")
        }
        self._more_left = float(np.sqrt(faults["steering_asymmetry.left_to_right"]))

    @staticmethod
    def rest(cars: int) -> NDArray:
        """Memory [n, len(RESTING)] at rest."""
        return np.tile(np.array(list(RESTING.values())), (cars, 1))

    def steering(
        self, memory: NDArray, command: NDArray, lateral: NDArray | float = 0.0
    ) -> NDArray:
        """Rack position [n] of a step, in command units; updates `memory`.

        T dy/dt = u - y, |ds/dt| <= rate, |x - s| <= width / 2, times the gain of its side.

        Args:
            memory: [n, len(RESTING)].
            command: [n].
            lateral: Acceleration [n] [m/s^2], positive to the left, of which tyres push back.
        """
        rack = self._horn(memory, command)
        memory[:, HORN_SPEED] = (rack - memory[:, HORN]) / self.h
        memory[:, HORN] = rack
        return self._linkage(memory, rack, lateral)

    def _horn(self, memory: NDArray, command: NDArray) -> NDArray:
        """Servo position [n]."""
        faults = self.faults
        if "steering_dead_zone" in faults:
            width = faults["steering_dead_zone.width"]
            command = np.sign(command) * np.maximum(np.abs(command) - width, 0.0)
        if "steering_lag" in faults:
            command = self._lagged(memory, SMOOTHED, "steering_lag", command)
        if "servo_stiction" in faults:
            error, width = np.abs(command - memory[:, HELD]), faults["servo_stiction.width"]
            going = (error > width) | ((memory[:, GOING] > 0.5) & (error > LET_GO * width))
            memory[:, GOING] = going
            memory[:, HELD] = np.where(going, command, memory[:, HELD])
            command = memory[:, HELD].copy()
        if "steering_rate_limit" in faults:
            reach = faults["steering_rate_limit.rate"] * self.h
            moved = np.clip(command - memory[:, SERVO], -reach, reach)
            memory[:, SERVO] += moved
            command = memory[:, SERVO] - 0.5 * moved  # the mean over the step
        return command

    def _linkage(self, memory: NDArray, rack: NDArray, lateral: NDArray | float) -> NDArray:
        """Wheel position [n] at which the linkage holds."""
        faults = self.faults
        if "steering_backlash" in faults:
            half = 0.5 * faults["steering_backlash.width"]
            memory[:, RACK] = np.clip(memory[:, RACK], rack - half, rack + half)
            rack = memory[:, RACK].copy()
        if "steering_play" in faults:
            pushed = 2.0 / np.pi * np.arctan(lateral / PUSHED)
            rack = rack - 0.5 * faults["steering_play.width"] * pushed
        if "steering_curve" in faults:
            bent = faults["steering_curve.curvature"]
            rack = rack * (1.0 - bent * (1.0 - rack * rack))
        if "steering_asymmetry" in faults:
            rack = rack * np.where(rack > 0, self._more_left, 1.0 / self._more_left)
        rack = rack * faults["steering_gain.gain"]
        if "steering_end_stop" in faults:
            left, right = (faults[f"steering_end_stop.{s}_cut"] for s in ("left", "right"))
            rack = np.clip(rack, right - 1.0, 1.0 - left)
        return rack

    def throttle(self, memory: NDArray, command: NDArray) -> NDArray:
        """Throttle [n] at the speed controller: T dy/dt = u - y, drive' = drive - width.

        It may be below -1, which is no drive. What is asked for heats: T dh/dt = drive^2 - h.
        """
        if "thermal_foldback" in self.faults:
            work = np.square(0.5 * (command + 1.0))
            rate = self.h / self.faults["thermal_foldback.time_constant"]
            memory[:, HEAT] += rate * (work - memory[:, HEAT])
        if "throttle_lag" in self.faults:
            command = self._lagged(memory, THROTTLE, "throttle_lag", command)
        return command - 2.0 * self.faults["throttle_deadband.width"]

    def duty(self, memory: NDArray, duty: NDArray) -> NDArray:
        """Duty cycle [n] of the motor behind gain and supply; above 1 of a higher voltage."""
        faults = self.faults
        if "voltage_sag" in faults:  # of a motor whose force goes with it
            duty = duty / (1.0 + faults["voltage_sag.resistance_ratio"] * np.square(duty))
        if "throttle_gain" in faults:
            duty = duty * faults["throttle_gain.gain"]
        if "battery_sag" in faults:
            lost = faults["battery_sag.loss_per_minute"] * memory[:, MINUTES]
            duty = duty * np.maximum(1.0 - lost, 0.0)
        if "thermal_foldback" in faults:
            duty = duty * (1.0 - faults["thermal_foldback.foldback"] * memory[:, HEAT])
        if "brown_out" in faults:
            fast = np.minimum(np.abs(memory[:, HORN_SPEED]) / DRAWN_AT, 1.0)
            held = faults["brown_out.holding"] * np.abs(memory[:, HORN])
            duty = duty * np.maximum(1.0 - faults["brown_out.moving"] * fast - held, 0.0)
        return duty

    def drained(self, memory: NDArray, force: NDArray) -> None:
        """Takes the charge of a step, with the motor's current in proportion to its force.

        dq/dt = e + (1 - e) F / F_typical, in minutes of mean driving per minute.

        Args:
            memory: [n, len(RESTING)], updated.
            force: [n] of the motor [N].
        """
        current = ELECTRONICS + (1.0 - ELECTRONICS) * np.maximum(force, 0.0) / self.typical
        memory[:, MINUTES] += current * self.h / 60.0

    def _lagged(self, memory: NDArray, column: int, effect: str, command: NDArray) -> NDArray:
        before = memory[:, column].copy()
        memory[:, column] = command + (before - command) * self._kept[effect]
        return 0.5 * (before + memory[:, column])


FRONT_DRAG = 0.015  # [kg/m] drag over speed squared: 1.2 kg/m^3, c_d = 1, 0.15 m x 0.16 m; chosen
SIDE_AREA = 2.0  # [-] drag from the side over that from the front; chosen
CONTACT_LENGTH = 0.03  # [m] of a tyre, over which its friction changes at the edge; chosen
DRAGGED = 0.1  # [-] share of the one-sided moment that is drag of a wheel; chosen
ROLLING = 0.3  # [m/s] speed at which a dragging wheel is at tanh(1) = 76 % of its force; chosen
Number = Any  # float or array
Moment = Callable[[Number, Number], Number]
Push = Callable[[Number, Number, Number, Number, Number], tuple[Number, Number, Number]]
PUSHES = frozenset(
    ("aerodynamic_drag", "wind", "one_sided_drag", "yaw_damping", "stiff_differential")
)
ALONG_STIFFNESS = 12.5  # [-] longitudinal force of a tyre over load and slip ratio; chosen
LOCKED_GRIP = 0.87  # [-] most of that force over the load; chosen
WALKING = 0.4  # [m/s] speed below which a locked axle's slip ratio grows no further; chosen


def push(
    faults: PlantFaults,
    rolling_share: Number,
    mass: Number,
    yaw_inertia: Number,
    half_track: float,
    rear_load: Number = 0.0,
) -> Push:
    """Builds the function of the forces on a car by its faults.

    Drag: -c |v| v. Wind: a stream W over the car's own way, F = k |w| (w_x, 2 w_y), less that of
    still air, with W from the stated acceleration at rest, mean of front and side. Decelerations
    are of the whole car with its turning wheels, so forces are larger by `rolling_share`.

    Args:
        faults: Of the surroundings.
        rolling_share: Mass of car and turning wheels over that of the car.
        mass: Of the car [kg].
        yaw_inertia: Of the car [kg m^2].
        half_track: Of the car [m].
        rear_load: Of its rear axle [N].

    Returns:
        f(cos, sin, vx, vy, yaw_rate) -> forward and leftward force over mass [m/s^2] and yaw
        acceleration [rad/s^2].
    """
    drag = faults["aerodynamic_drag.coefficient"] * rolling_share
    moment = faults["one_sided_drag.yaw_acceleration"]
    dragging = DRAGGED * abs(moment) * yaw_inertia / (half_track * mass)  # [m/s^2]
    damping = faults["yaw_damping.rate"]
    locked = locked_couple(faults, rear_load, half_track)
    stream = FRONT_DRAG / mass
    wind_x, wind_y = _wind_speed(faults, rolling_share, stream)

    def air(along, across):
        flow = stream * np.hypot(along, across)
        return flow * along, SIDE_AREA * flow * across

    def pushed(cos, sin, vx, vy, yaw_rate):
        speed = np.hypot(vx, vy)
        rolling = np.tanh(vx / ROLLING)
        ax, ay = -(drag * speed * vx + dragging * rolling), -drag * speed * vy
        if "wind" in faults:
            along, across = cos * wind_x + sin * wind_y - vx, cos * wind_y - sin * wind_x - vy
            blown, still = air(along, across), air(-vx, -vy)
            ax, ay = ax + blown[0] - still[0], ay + blown[1] - still[1]
        stiff = locked(vx, yaw_rate) / yaw_inertia
        return ax, ay, moment * rolling - damping * yaw_rate + stiff

    return pushed


def locked_couple(faults: PlantFaults, load: Number, half_track: float) -> Moment:
    """Builds the moment of a stiff rear differential.

    The wheels of a locked axle slip by h r / v, h the half track, one forward and one back:
    M = -q h N f(c h r / (mu v)) mu, f(x) = x / sqrt(1 + x^2), a share q of a locked axle's.

    Args:
        faults: Of the car.
        load: Of the rear axle [N].
        half_track: Of the car [m].

    Returns:
        f(vx, yaw_rate) -> moment [N m].
    """
    share = faults["stiff_differential.coupling"]

    def moment(vx, yaw_rate):
        slip = half_track * yaw_rate / np.maximum(np.abs(vx), WALKING)
        use = ALONG_STIFFNESS / LOCKED_GRIP * slip
        return -share * half_track * load * LOCKED_GRIP * use / np.sqrt(1.0 + use * use)

    return moment


def turned_back(faults: PlantFaults, vx: Number, yaw_rate: Number, ax: Number) -> Number:
    """Angle [rad] by which forces turn the front wheels: a linkage that gives way, and pitch.

    Side force over mass is that of a steady turn, vx yaw_rate; `ax` [m/s^2] is the forward one.
    """
    back = faults["understeer.gradient"] * vx * yaw_rate
    return faults["dive_steer.angle"] * ax - back


def _wind_speed(
    faults: PlantFaults, rolling_share: Number, stream: Number
) -> tuple[Number, Number]:
    """World velocity of the wind [m/s]: m f = k W^2, k the mean of front and side."""
    x, y = faults["wind.force_x"], faults["wind.force_y"]
    size = np.hypot(x, y)
    if size == 0.0:
        return 0.0, 0.0
    speed = np.sqrt(size * rolling_share / (0.5 * (1.0 + SIDE_AREA) * stream))
    return speed * x / size, speed * y / size


def patch_grip(faults: PlantFaults, x, y):
    """Friction at a place (x, y) [m] of the world over that of the floor."""
    distance = np.hypot(x - faults["grip_patch.x"], y - faults["grip_patch.y"])
    inside = (faults["grip_patch.radius"] - distance) / CONTACT_LENGTH + 0.5
    return 1.0 - (1.0 - faults["grip_patch.grip"]) * np.clip(inside, 0.0, 1.0)
