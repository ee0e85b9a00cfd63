"""Classes of the effects that can be concealed, by which balanced draws are made and counted."""

CLASSES: dict[str, tuple[str, ...]] = {
    # What the sensor shows of a motion that is right.
    "sensing": (*("sensor_yaw", "sensor_lever_arm", "pose_scale", "speed_scale", "gyro_bias"),),
    # Maps from a command to the wheels, with no time of their own.
    "command": (
        *("throttle_gain", "throttle_offset", "throttle_deadband", "steering_gain"),
        *("steering_offset", "steering_asymmetry", "steering_curve", "steering_dead_zone"),
        *("steering_end_stop", "steering_backlash", "steering_play", "servo_stiction"),
        *("brake_gain", "reverse_deadband", "least_speed"),
    ),
    # What drives and slows the car.
    "force": (
        *("aerodynamic_drag", "rolling_resistance", "viscous_drag", "cornering_drag"),
        *("steering_drag", "one_sided_drag", "torque_steer", "motor_power_limit", "top_speed"),
        *("voltage_sag", "gear_ratio", "brown_out", "brake_balance", "drag_brake"),
    ),
    # Between wheel and floor.
    "tyre": ("tire_grip", "grip_balance", "cornering_stiffness", "driven_axle_slip"),
    # Mass, suspension, linkage and differential.
    "body": ("payload", "understeer", "dive_steer", "yaw_damping", "stiff_differential"),
    # Fixed to the room.
    "place": ("grip_patch", "floor_slope", "wind"),
    # What comes late, or changes while the car is driven.
    "time": (
        *("throttle_dead_time", "steering_dead_time", "throttle_lag", "steering_lag"),
        *("steering_rate_limit", "sensor_latency", "sensor_lag", "heading_drift", "battery_sag"),
        *("thermal_foldback", "speed_controller_lag", "speed_ramp", "speed_integral"),
    ),
}
_CLASS_OF = {effect: name for name, effects in CLASSES.items() for effect in effects}


def class_of(effect: str) -> str:
    """The class of an effect of the library.

    Raises:
        KeyError: It has none: it must be entered in `CLASSES`.
    """
    if effect not in _CLASS_OF:
        raise KeyError(f"effect {effect} has no class: enter it in proof/cases/classes.py")
    return _CLASS_OF[effect]
