"""What can be wrong with a foreign plant, by its textbook name; all of it off by default.

Signs, units and meaning are the textbook's; each plant says in its own words how they act in it.
"""

from collections.abc import Mapping

from buggy_rl.parameters import Parameter

ACTUATION = (
    Parameter("throttle_dead_time.dead_time", 0.0, 0.0, 0.17, "s", "Heard late."),
    Parameter("steering_dead_time.dead_time", 0.0, 0.0, 0.17, "s", "Heard late."),
    Parameter("throttle_lag.time_constant", 0.0, 0.0, 1.0, "s", "Further smoothing."),
    Parameter("steering_lag.time_constant", 0.0, 0.0, 0.5, "s", "Further smoothing."),
    # Neutral far above what any servo of this size does.
    Parameter("steering_rate_limit.rate", 100.0, 0.5, 100.0, "1/s", "Fastest steering command."),
    Parameter("throttle_gain.gain", 1.0, 0.3, 1.5, "-", "Duty cycle given over the right one."),
    Parameter("steering_gain.gain", 1.0, 0.3, 1.5, "-", "Road-wheel angle over the right one."),
    Parameter("throttle_offset.offset", 0.0, -0.5, 0.5, "-", "Trim, in command."),
    Parameter("steering_offset.offset", 0.0, -0.5, 0.5, "-", "Trim, in command."),
    Parameter("throttle_deadband.width", 0.0, 0.0, 0.4, "-", "Drive lost, on top of the own."),
    Parameter("steering_backlash.width", 0.0, 0.0, 0.6, "-", "Play from stop to stop."),
    Parameter("steering_asymmetry.left_to_right", 1.0, 0.5, 2.0, "-", "Left angles over right."),
    Parameter("battery_sag.loss_per_minute", 0.0, 0.0, 0.8, "1/min", "Drive lost in driving."),
)
RESISTANCE = (
    Parameter("aerodynamic_drag.coefficient", 0.0, 0.0, 0.5, "1/m", "Slowing over speed squared."),
    Parameter("rolling_resistance.deceleration", 0.0, 0.0, 2.0, "m/s^2", "Dry drag of wheels."),
    Parameter("viscous_drag.rate", 0.0, 0.0, 2.0, "1/s", "Slowing over speed."),
    Parameter("cornering_drag.coefficient", 0.0, 0.0, 1.0, "-", "Slowing over lateral force."),
    Parameter("one_sided_drag.yaw_acceleration", 0.0, -30, 30, "rad/s^2", "A bent axle."),
    Parameter("yaw_damping.rate", 0.0, 0.0, 20.0, "1/s", "Slowing of the yaw rate over it."),
)
PLACE = (
    Parameter("floor_slope.along_x", 0.0, -2.0, 2.0, "m/s^2", "Gravity along world x."),
    Parameter("floor_slope.along_y", 0.0, -2.0, 2.0, "m/s^2", "Gravity along world y."),
    Parameter("wind.force_x", 0.0, -2.0, 2.0, "m/s^2", "Push on a standing car over its mass."),
    Parameter("wind.force_y", 0.0, -2.0, 2.0, "m/s^2", "Push on a standing car over its mass."),
    Parameter("grip_patch.x", 0.0, -20.0, 20.0, "m", "Middle of the patch in the world."),
    Parameter("grip_patch.y", 0.0, -20.0, 20.0, "m", "Middle of the patch in the world."),
    Parameter("grip_patch.radius", 0.0, 0.0, 10.0, "m", "Of the patch."),
    Parameter("grip_patch.grip", 1.0, 0.1, 1.5, "-", "Friction on it over that of the floor."),
)
CAR = (
    Parameter("tire_grip.grip", 1.0, 0.2, 1.5, "-", "Peak friction over that of the right tyre."),
    Parameter("grip_balance.front_to_rear", 1.0, 0.5, 2.0, "-", "Front over rear; product kept."),
    Parameter("payload.mass_ratio", 1.0, 0.7, 2.0, "-", "Mass on the floor over the bare car's."),
    # Neutral far above what the motor does by itself.
    Parameter("motor_power_limit.power_per_mass", 1e3, 1.0, 1e3, "W/kg", "Limit at the shaft."),
    Parameter("top_speed.speed_ratio", 1.0, 0.3, 1.5, "-", "Free speed over the right motor's."),
)
FAULTS = {fault.name: fault for fault in (*ACTUATION, *RESISTANCE, *PLACE, *CAR)}
EFFECTS = frozenset(name.partition(".")[0] for name in FAULTS)


class Faults:
    """The faults of a plant, all its cars alike.

    `faults["wind.force_x"]` is a number, `"wind" in faults` says whether there is such a fault.

    Args:
        given: `{effect: {parameter: value}}`; what is not named is neutral.
        abilities: Effects the plant can have.
        plant: Its name, for errors.

    Raises:
        KeyError: The plant has no such effect, or the effect no such parameter.
        ValueError: A value is outside its range.
    """

    def __init__(
        self, given: Mapping[str, Mapping[str, float]], abilities: frozenset[str], plant: str
    ) -> None:
        unknown = sorted(set(given) - abilities)
        if unknown:
            raise KeyError(
                f"the {plant} plant has no effect {', '.join(unknown)}; "
                f"available: {', '.join(sorted(abilities))}"
            )
        self.given = {effect: dict(parameters) for effect, parameters in given.items()}
        self._values = {name: fault.value for name, fault in FAULTS.items()}
        for effect, parameters in self.given.items():
            for parameter, value in parameters.items():
                self._values[f"{effect}.{parameter}"] = _checked(effect, parameter, float(value))
        self.active = frozenset(
            name.partition(".")[0] for name, value in self._values.items() if self._off(name, value)
        )

    @staticmethod
    def _off(name: str, value: float) -> bool:
        # A place is no fault by itself.
        return value != FAULTS[name].value and name not in ("grip_patch.x", "grip_patch.y")

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __contains__(self, effect: object) -> bool:
        return effect in self.active


def _checked(effect: str, parameter: str, value: float) -> float:
    name = f"{effect}.{parameter}"
    if name not in FAULTS:
        known = [n.partition(".")[2] for n in FAULTS if n.startswith(f"{effect}.")]
        raise KeyError(f"effect {effect} has no parameter {parameter}; it has {', '.join(known)}")
    fault = FAULTS[name]
    if not fault.lower <= value <= fault.upper:
        raise ValueError(
            f"fault {name} is {value:g} {fault.unit}: must be in [{fault.lower:g}, {fault.upper:g}]"
        )
    return value
