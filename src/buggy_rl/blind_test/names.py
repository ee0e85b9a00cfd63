"""When two names say the same, or nearly so."""

from buggy_rl.estimation.hypothesis import OWN

# A simulator's own parameter that is the effect: "the lag is 0.12 s, not 0.06 s".
SAME = {
    "steering_lag": "steering_lag",
    "steering_dead_time": "steering_dead_time",
    "throttle_lag": "throttle_lag",
    "throttle_dead_time": "throttle_dead_time",
    "throttle_deadband": "throttle_deadband",
    "steering_offset": "steering_offset",
    "rolling_resistance": "rolling_resistance",
    "dry_friction": "rolling_resistance",
    "viscous_drag": "viscous_drag",
    "viscous_friction": "viscous_drag",
    "quadratic_drag": "aerodynamic_drag",
    "mass": "payload",
    "drive_force": "throttle_gain",
    "drive_force_loss": "top_speed",
    "drive_speed_loss": "top_speed",
    "sensor_x": "sensor_lever_arm",
    "sensor_y": "sensor_lever_arm",
}
# A simulator's own parameter that is a part of the effect, or makes the same motion.
NEAR = {
    "grip_front": "tire_grip",
    "grip_rear": "tire_grip",
    "front_grip": "tire_grip",
    "rear_grip": "tire_grip",
    "cornering_stiffness_front": "grip_balance",
    "cornering_stiffness_rear": "grip_balance",
    "front_stiffness": "grip_balance",
    "rear_stiffness": "grip_balance",
    "tyre_shape": "tire_grip",
    "front_shape": "grip_balance",
    "rear_shape": "grip_balance",
    "steering_left": "steering_asymmetry",
    "steering_right": "steering_asymmetry",
    "left_angle": "steering_asymmetry",
    "right_angle": "steering_asymmetry",
    "left_steepness": "steering_asymmetry",
    "right_steepness": "steering_asymmetry",
    "steering_drag": "cornering_drag",
    "steering_drag_speed": "cornering_drag",
    "yaw_inertia": "yaw_damping",
    "cg_to_front_axle": "grip_balance",
    "cg_to_rear_axle": "grip_balance",
}
GROUPS = (  # effects that are easily confounded; those of one group are one answer to a driver
    {"steering_dead_time", "steering_lag", "steering_rate_limit", "steering_backlash"},
    {"throttle_dead_time", "throttle_lag"},
    {"sensor_latency", "sensor_lag"},
    {"aerodynamic_drag", "rolling_resistance", "viscous_drag", "top_speed", "motor_power_limit"},
    {"throttle_gain", "throttle_deadband", "throttle_offset", "battery_sag", "payload"},
    {"rolling_resistance", "throttle_offset", "throttle_deadband"},
    {"steering_offset", "one_sided_drag", "sensor_yaw"},
    {"floor_slope", "wind"},
    {"steering_gain", "steering_asymmetry", "grip_balance", "sensor_lever_arm", "yaw_damping"},
    {"tire_grip", "grip_patch", "grip_balance", "payload"},
)


def meant(name: str) -> str:
    """The effect that an answer's name stands for."""
    own = name.removeprefix(OWN)
    return SAME.get(own, name) if name.startswith(OWN) else name


def alike(one: str, other: str) -> bool:
    """Whether two names are of one group."""
    first, second = (NEAR.get(n.removeprefix(OWN), meant(n)) for n in (one, other))
    return first == second or any(first in group and second in group for group in GROUPS)
