"""Ranges of the sizes of concealed effects; they are the generator's own, not a prior.

An effect library tuned on these ranges would know a part of the answer. The lower bound is what a
driver notices, the upper one what makes him stop.
"""

import math
import random
from collections.abc import Mapping
from typing import NamedTuple

from buggy_rl.core.vehicle import Similarity
from buggy_rl.proof.plants.composed import Sort
from buggy_rl.proof.plants.rally.unknowns import UNKNOWNS
from buggy_rl.simulators.reference.faults import FAULTS


class Uniform(NamedTuple):
    """Bounds of a uniform distribution."""

    low: float
    high: float
    signed: bool
    """Whether the sign is drawn too."""
    why: str

    def drawn(self, chance: random.Random) -> float:
        """A value, rounded to what a ledger keeps."""
        side = -1 if self.signed and chance.random() < 0.5 else 1
        return round(side * chance.uniform(self.low, self.high), 4)


class LogUniform(NamedTuple):
    """Bounds of a distribution in which every factor of the size is as likely."""

    low: float
    high: float
    why: str

    def drawn(self, chance: random.Random) -> float:
        """A value, rounded to four digits."""
        value = math.exp(chance.uniform(math.log(self.low), math.log(self.high)))
        return float(f"{min(max(value, self.low), self.high):.4g}")


SIZES: dict[str, dict[str, Uniform]] = {
    "throttle_dead_time": {
        "dead_time": Uniform(0.04, 0.12, False, "a radio of 25 Hz; two of its frames and a filter")
    },
    "steering_dead_time": {
        "dead_time": Uniform(
            0.03, 0.1, False, "an analogue servo's frame and a half; DART 0.09-0.14"
        )
    },
    "throttle_lag": {
        "time_constant": Uniform(0.08, 0.25, False, "a controller's soft start, mild to sluggish")
    },
    "steering_lag": {
        "time_constant": Uniform(0.05, 0.15, False, "twice the car's own servo; DART's 0.13")
    },
    "steering_rate_limit": {
        "rate": Uniform(
            2.0, 4.0, False, "0.4 to 0.25 s from centre to lock: a servo at low voltage"
        )
    },
    "throttle_gain": {"gain": Uniform(0.75, 0.9, False, "endpoint of the radio set by thumb")},
    "steering_gain": {"gain": Uniform(0.75, 0.9, False, "next hole of a servo horn: 10 to 25 %")},
    "throttle_offset": {"offset": Uniform(0.05, 0.12, True, "a few clicks of trim, of 1/40 each")},
    "steering_offset": {
        "offset": Uniform(0.05, 0.15, True, "a spline tooth of the horn is 15 deg")
    },
    "throttle_deadband": {"width": Uniform(0.04, 0.1, False, "up to two thirds of the car's own")},
    "steering_backlash": {"width": Uniform(0.1, 0.25, False, "2 to 5 deg at the road wheel: worn")},
    "steering_asymmetry": {"left_to_right": Uniform(0.7, 0.87, False, "DART: 0.32 over 0.40")},
    "battery_sag": {"loss_per_minute": Uniform(0.15, 0.4, False, "empty in 2 to 6 minutes: worn")},
    "aerodynamic_drag": {
        "coefficient": Uniform(0.05, 0.15, False, "a sheet of 15 cm by 60 to 180 cm on 1.6 kg")
    },
    "rolling_resistance": {
        "deceleration": Uniform(0.2, 0.5, False, "a carpet instead of a floor: 2 to 5 % of g")
    },
    "viscous_drag": {"rate": Uniform(0.12, 0.35, False, "bearings with stiff grease")},
    "cornering_drag": {
        "coefficient": Uniform(0.016, 0.05, False, "one to three times the tyres' own; 0.1 g at 5")
    },
    "steering_drag": {
        "per_angle": Uniform(1.5, 4.5, False, "DART: 3.4 at 1 m/s; loaded joints, no Ackermann")
    },
    "floor_slope": {
        "along_x": Uniform(0.15, 0.4, True, "0.9 to 2.3 degrees: a garage floor's fall"),
        "along_y": Uniform(0.15, 0.4, True, "likewise"),
    },
    "wind": {
        "force_x": Uniform(0.15, 0.4, True, "a fan in the room: 2 to 3 m/s over the car"),
        "force_y": Uniform(0.15, 0.4, True, "likewise"),
    },
    "one_sided_drag": {
        "yaw_acceleration": Uniform(6.0, 14.0, True, "1 to 2 N at one wheel: a bent axle")
    },
    "yaw_damping": {
        "rate": Uniform(3.0, 8.0, False, "tyres that scrub: turns die in 0.1 to 0.3 s")
    },
    "torque_steer": {
        "offset": Uniform(0.005, 0.015, True, "one rear wheel pulls 15 to 45 % less than the other")
    },
    "stiff_differential": {
        "coupling": Uniform(0.35, 0.9, False, "a tight gear differential to a nearly locked one")
    },
    "understeer": {"gradient": Uniform(0.004, 0.012, False, "a servo saver: 2 to 7 degrees a g")},
    "cornering_stiffness": {"ratio": Uniform(0.5, 0.75, False, "softer inserts or tyres on foam")},
    "dive_steer": {"angle": Uniform(0.006, 0.015, True, "1 to 2.6 degrees at full throttle")},
    "tire_grip": {"grip": Uniform(0.55, 0.8, False, "tiles or tape for rubber: DART about half")},
    "grip_balance": {"front_to_rear": Uniform(0.7, 0.85, False, "a pair of worn front tyres")},
    "grip_patch": {
        "x": Uniform(0.0, 1.5, True, "where room drives come by"),
        "y": Uniform(0.0, 1.5, True, "likewise"),
        "radius": Uniform(1.0, 1.6, False, "a rug, a tenth to a third of the room"),
        "grip": Uniform(0.3, 0.55, False, "dust or polish"),
    },
    "payload": {
        "mass_ratio": Uniform(1.15, 1.5, False, "a camera to a second battery with a lidar")
    },
    "motor_power_limit": {
        "power_per_mass": Uniform(2.0, 4.0, False, "3 to 6 W at the shaft: reached below 2 m/s")
    },
    "top_speed": {"speed_ratio": Uniform(0.45, 0.7, False, "a motor of half to two thirds the kV")},
    "sensor_latency": {"dead_time": Uniform(0.02, 0.06, False, "one or two frames and transport")},
    "sensor_lag": {"time_constant": Uniform(0.03, 0.08, False, "a tracker that smooths")},
    "sensor_yaw": {"angle": Uniform(0.03, 0.1, True, "2 to 6 degrees: fixed by eye")},
    "sensor_lever_arm": {
        "x": Uniform(0.03, 0.08, True, "fixed another place on the car, 27 cm long"),
        "y": Uniform(0.02, 0.06, True, "likewise, 14 cm wide"),
    },
    "pose_scale": {"ratio": Uniform(0.85, 0.94, False, "T265 indoors: up to 20 % off")},
    "heading_drift": {
        "rate": Uniform(0.01, 0.03, True, "half to 2 degrees a second: lost features")
    },
    "speed_scale": {"ratio": Uniform(0.9, 0.96, False, "a camera with its scale off")},
    "gyro_bias": {"bias": Uniform(0.05, 0.2, True, "3 to 11 degrees a second: not calibrated")},
    "servo_stiction": {"width": Uniform(0.1, 0.25, False, "a servo's dead band, a dirty linkage")},
    "steering_dead_zone": {"width": Uniform(0.06, 0.15, False, "a gamepad's stick: a tenth of it")},
    "steering_curve": {"curvature": Uniform(0.2, 0.5, False, "20 to 50 % exponential of a radio")},
    "steering_end_stop": {
        "left_cut": Uniform(0.25, 0.5, False, "a horn a spline off, a body in the way"),
        "right_cut": Uniform(0.1, 0.25, False, "the same, less on the other side"),
    },
    "steering_play": {"width": Uniform(0.12, 0.3, False, "as backlash, of worn ball joints")},
    "voltage_sag": {
        "resistance_ratio": Uniform(0.3, 0.8, False, "an old or cold pack, thin wires")
    },
    "thermal_foldback": {
        "foldback": Uniform(0.5, 0.9, False, "a controller at its limit: half the power or less"),
        "time_constant": Uniform(8.0, 16.0, False, "a small controller without a fan"),
    },
    "brown_out": {
        "moving": Uniform(0.4, 0.9, False, "a BEC that cannot feed the servo: the drive stutters"),
        "holding": Uniform(0.1, 0.3, False, "less for a servo that holds"),
    },
    "gear_ratio": {"ratio": Uniform(1.15, 1.5, False, "a pinion of three to eight teeth less")},
}
UNKNOWN_SIZES: dict[str, dict[str, Uniform]] = {
    "sticky_servo": {"breakaway": Uniform(0.15, 0.3, False, "moves when off by 3 to 6 degrees")},
    "bump_steer": {"angle": Uniform(0.008, 0.016, True, "2 to 5 degrees at half a g")},
    "wheel_wobble": {"angle": Uniform(0.05, 0.12, False, "3 to 7 degrees: a bent rim")},
    "drag_brake": {"share": Uniform(0.15, 0.5, False, "the controller's setting")},
    "heating_motor": {"rise": Uniform(0.005, 0.015, False, "half the power after a burst")},
    "loose_differential": {"time_constant": Uniform(0.08, 0.2, False, "the left half comes later")},
}
RALLY_SIZES = {
    kind: {"size": LogUniform(low, high, mechanism)}
    for kind, (low, high, mechanism) in UNKNOWNS.items()
}
"""Unknown effects of the rally car, in the ranges of their author."""
NAMED_SINCE = {  # unknown kinds that have got a name: they are drawn under it
    "sticky_servo": "servo_stiction",
    "heating_motor": "thermal_foldback",
    "bump_steer": "understeer",
}
COMMANDED_SIZES: dict[str, dict[str, Uniform]] = {  # of cars with brakes, or a speed controller
    "brake_gain": {"gain": Uniform(0.6, 0.85, False, "brake end point of the radio set by thumb")},
    "brake_balance": {
        "shift": Uniform(0.25, 0.5, True, "a pair of brakes that drags or has faded")
    },
    "reverse_deadband": {
        "width": Uniform(0.05, 0.15, False, "a controller not calibrated: to 15 %")
    },
    "drag_brake": {
        "deceleration": Uniform(0.4, 1.2, False, "10 to 30 % of the motor's brake, as menus offer")
    },
    "speed_controller_lag": {
        "time_constant": Uniform(0.06, 0.15, False, "an integral gain set low, a filtered encoder")
    },
    "driven_axle_slip": {
        "slip_per_acceleration": Uniform(0.015, 0.04, False, "the rear tyres' own to twice as soft")
    },
    "speed_ramp": {
        "acceleration": Uniform(0.8, 2.5, False, "a firmware's ramp turned down: MIT's car has 2.5")
    },
    "least_speed": {"speed": Uniform(0.3, 0.8, False, "900 to 3000 ERPM of a sensorless motor")},
    "speed_integral": {
        "rate": Uniform(1.0, 4.0, False, "an integral gain of one to four times P's")
    },
}
CAMERA = {  # where a sensing effect is an error of the camera: parameter -> field of its config
    "sensor_latency": {"dead_time": "latency"},
    "sensor_lag": {"time_constant": "lag"},
    "sensor_yaw": {"angle": "yaw"},
    "sensor_lever_arm": {"x": "lever_arm_x", "y": "lever_arm_y"},
    "pose_scale": {"ratio": "pose_scale"},
    "heading_drift": {"rate": "heading_drift"},
    "speed_scale": {"ratio": "speed_scale"},
    "gyro_bias": {"bias": "gyro_bias"},
}
COMPOSED_SIZES = {  # where a composed sort acts -> how much, at a signal of 1
    "forward": Uniform(0.4, 1.2, True, "as rolling resistance and slope, twice over"),
    "side": Uniform(0.5, 1.5, True, "a sixth of the grip at most"),
    "yaw": Uniform(5.0, 14.0, True, "as a bent axle"),
    "throttle": Uniform(0.15, 0.4, True, "a fifth of the channel at most"),
    "steering": Uniform(0.08, 0.25, True, "as a wrong trim"),
    "seen_yaw": Uniform(0.02, 0.06, True, "1 to 3 degrees"),
    "seen_speed": Uniform(0.05, 0.15, True, "2 to 6 % of 2.5 m/s"),
    "seen_drift": Uniform(0.05, 0.15, True, "likewise, across"),
    "seen_yaw_rate": Uniform(0.1, 0.3, True, "6 to 17 degrees a second"),
}
FAINTER = {  # shape or memory -> share that it leaves of a typical signal's mean square root
    "square": 0.7,
    "threshold": 0.4,
    "lag": 0.6,
    "heat": 0.7,
}
TIME_CONSTANTS = {  # of a memory [s]
    "lag": Uniform(0.15, 0.8, False, "slower than a servo, faster than a bend"),
    "heat": Uniform(5.0, 20.0, False, "a motor or a tyre that warms"),
}


UNITS = {fault.name: fault.unit for fault in FAULTS} | {
    "sensor_lever_arm.x": "m",
    "sensor_lever_arm.y": "m",
    "gyro_bias.bias": "rad/s",
    "heading_drift.rate": "rad/s",
}


def scaled_effect(effect: str, values: Mapping[str, float], scale: Similarity) -> dict[str, float]:
    """Numbers of an effect in a car of another size, by its ratios to the buggy.

    Delays and lags of electronics stay, as do ratios and what goes with gravity; a servo's lag
    goes with the car's own.
    """
    factors = {name: scale.of(UNITS.get(f"{effect}.{name}", "-")) for name in values}
    if effect == "steering_lag":
        factors = {"time_constant": scale.time}
    return {name: float(f"{factors[name] * value:.6g}") for name, value in values.items()}


def composed_sizes(name: str) -> dict[str, Uniform]:
    """Ranges of the numbers of a composed sort."""
    sort = Sort.named(name)
    low, high, signed, why = COMPOSED_SIZES[sort.where]
    # As large as sorts without them: most would be below what any drive shows.
    share = FAINTER.get(sort.shape, 1.0) * FAINTER.get(sort.memory, 1.0)
    ranges = {"size": Uniform(low / share, high / share, signed, why)}
    if sort.memory in TIME_CONSTANTS:
        ranges["time_constant"] = TIME_CONSTANTS[sort.memory]
    if sort.of in ("way", "place"):
        ranges["phase"] = Uniform(0.0, 3.1, True, "anywhere")
    return ranges
