"""Decides when an answer says the same as the truth: equal effects, and equal numbers of each.

A fault in a car's own physics is not always the textbook's term at the commands or on the velocity:
where the two differ by a known factor, an answer is measured against the textbook's number.
"""

from collections.abc import Mapping

from buggy_rl.effects import EFFECTS
from buggy_rl.estimation.hypothesis import OWN
from buggy_rl.proof.cases.case import Concealing

SAME = {  # a simulator's own parameter -> the effect that it is: "the lag is 0.12 s, not 0.06 s"
    parameter: effect
    for effect, parameters in {
        "steering_lag": ["steering_lag"],
        "steering_dead_time": ["steering_dead_time"],
        "throttle_lag": ["throttle_lag"],
        "throttle_dead_time": ["throttle_dead_time"],
        "throttle_deadband": ["throttle_deadband"],
        "steering_offset": ["steering_offset"],
        "rolling_resistance": ["rolling_resistance", "dry_friction"],
        "viscous_drag": ["viscous_drag", "viscous_friction"],
        "aerodynamic_drag": ["quadratic_drag"],
        "payload": ["mass"],
        "throttle_gain": ["drive_force"],
        "top_speed": ["drive_force_loss", "drive_speed_loss"],
        "gear_ratio": ["gear_ratio"],
        "voltage_sag": ["battery_resistance"],
        "steering_drag": ["steering_drag"],
        "sensor_lever_arm": ["sensor_x", "sensor_y"],
    }.items()
    for parameter in parameters
}
NEAR = {  # a simulator's own parameter -> an effect that it is a part of, or that moves alike
    parameter: effect
    for effect, parameters in {
        "tire_grip": "grip_front grip_rear front_grip rear_grip tyre_shape",
        "grip_balance": "cornering_stiffness_front cornering_stiffness_rear front_stiffness "
        "rear_stiffness front_shape rear_shape cg_to_front_axle cg_to_rear_axle",
        "steering_asymmetry": "steering_left steering_right left_angle right_angle "
        "left_steepness right_steepness",
        "steering_drag": "steering_drag_speed",
        "yaw_damping": "yaw_inertia",
    }.items()
    for parameter in parameters.split()
}
GROUPS = (  # effects that are easily confounded; those of one group are one answer to a driver
    {"steering_dead_time", "steering_lag", "steering_rate_limit", "steering_backlash"},
    {"steering_backlash", "servo_stiction", "steering_dead_zone"},
    {"steering_gain", "steering_curve", "steering_dead_zone", "steering_play"},
    {"steering_asymmetry", "steering_end_stop"},
    {"speed_ramp", "speed_controller_lag", "throttle_lag"},
    {"least_speed", "throttle_deadband"},
    {"voltage_sag", "top_speed", "gear_ratio", "motor_power_limit"},
    {"battery_sag", "thermal_foldback"},
    {"gear_ratio", "payload", "throttle_gain"},
    {"throttle_dead_time", "throttle_lag"},
    {"sensor_latency", "sensor_lag"},
    {"aerodynamic_drag", "rolling_resistance", "viscous_drag", "top_speed", "motor_power_limit"},
    {"throttle_gain", "throttle_deadband", "throttle_offset", "battery_sag", "payload"},
    {"rolling_resistance", "throttle_offset", "throttle_deadband"},
    {"cornering_drag", "steering_drag"},
    {"torque_steer", "dive_steer"},
    {"yaw_damping", "stiff_differential", "understeer", "cornering_stiffness"},
    {"pose_scale", "speed_scale"},
    {"heading_drift", "gyro_bias"},
    {"steering_offset", "one_sided_drag", "sensor_yaw"},
    {"floor_slope", "wind"},
    {"steering_gain", "steering_asymmetry", "grip_balance", "sensor_lever_arm", "yaw_damping"},
    {"tire_grip", "grip_patch", "grip_balance", "payload"},
)


def meant(name: str) -> str:
    """The effect that an answer's name stands for."""
    own = name.removeprefix(OWN)
    return SAME.get(own, name) if name.startswith(OWN) else name


def of_same_name(effect: str) -> str:
    """The effect that a parameter of a simulator has the name of; others stand for themselves.

    A dead time of the steering is the same whether it is added to the simulator or a number of it.
    """
    own = effect.removeprefix(OWN)
    return own if own in EFFECTS else effect


def same_group(one: str, other: str) -> bool:
    """Whether two names are of one group."""
    first, second = (NEAR.get(n.removeprefix(OWN), meant(n)) for n in (one, other))
    return first == second or any(first in group and second in group for group in GROUPS)


# Gravity, or power at the shaft, has to spin the wheels and the rotor too: the textbook's number is
# the plant's times the share of the moved mass that is the car's. A rally car's slope is told by
# the acceleration of the free car, since that share is another in each of them.
MASS_SHARE = {
    "reference": 1 / 1.1176,  # wheels and rotor add 11.8 %
    "mujoco": 0.92,  # as the docstring of the plant has it
    "commonroad": 0.90,  # likewise
}
SCALED = {"floor_slope", "motor_power_limit"}  # effects whose numbers are scaled by that share


def expected(case: Concealing, effect: str) -> dict[str, float]:
    """The numbers that a right answer has for an effect of a case."""
    factor = MASS_SHARE.get(case.plant, 1.0) if effect in SCALED else 1.0
    return {name: factor * value for name, value in case.concealed[effect].items()}


def error(effect: str, said: Mapping[str, float], truth: Mapping[str, float]) -> float:
    """How far an answer's numbers are off, relative to the true ones.

    |said - true| / |true|; of a vector the lengths; of a patch its middle over its radius, its
    radius and its grip, whichever is worst.
    """
    if effect == "grip_patch":
        middle = sum((said[k] - truth[k]) ** 2 for k in ("x", "y")) ** 0.5
        others = [abs(said[k] - truth[k]) / abs(truth[k]) for k in ("radius", "grip")]
        return max(middle / truth["radius"], *others)
    names = [name for name in truth if name in said]
    if not names:
        return float("inf")
    off = sum((said[k] - truth[k]) ** 2 for k in names) ** 0.5
    return off / sum(truth[k] ** 2 for k in names) ** 0.5
