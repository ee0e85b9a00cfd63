"""What some effects must know of the simulator they stand over, found by driving it.

A simulator may be a black box, but it can be put into any motion: held there until its delays have
settled, its next step shows the forces.
"""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from buggy_rl.effects.measuring.drive import measured_drive, measured_onset
from buggy_rl.effects.measuring.holding import Make
from buggy_rl.effects.measuring.servo import measured_steering_lag
from buggy_rl.effects.measuring.tyres import measured_tyres
from buggy_rl.vehicle import VehicleDimensions

SERVO_EFFECTS = ("steering_backlash", "steering_rate_limit")
PULL_EFFECTS = ("throttle_gain", "battery_sag")
YAW_EFFECTS = ("one_sided_drag", "yaw_damping")
TYRE_EFFECTS = ("tire_grip", "grip_balance", "grip_patch")
TYPICAL = (6.1, 9.4)  # [1/rad] stiffness over load of front and rear: DART's


def measured_options(
    make: Make, dimensions: VehicleDimensions | Mapping[str, float] | None = None
) -> dict[str, dict[str, Any]]:
    """Options of the effects that need them, by the effect's name, as `make_effect` takes them.

    Args:
        make: Builds the simulator for a number of cars.
        dimensions: Of a car whose simulator has none, or those that differ from the buggy's.

    Raises:
        ValueError: The simulator's answer is not finite.
    """
    if not isinstance(dimensions, VehicleDimensions):
        dimensions = VehicleDimensions(**(dimensions or {}))
    options: dict[str, dict[str, Any]] = {}
    for part in (
        _drive_options(make),
        _servo_options(make),
        _tyre_options(make, dimensions),
    ):
        _add(options, part)
    return options


def _add(options: dict[str, dict[str, Any]], more: Mapping[str, Mapping[str, Any]]) -> None:
    for name, values in more.items():
        options[name] = {**options.get(name, {}), **values}


def _drive_options(make: Make) -> dict[str, dict[str, Any]]:
    drive, onset = measured_drive(make), {"onset": measured_onset(make)}
    loss = {"speed_loss": drive["speed_loss"]}
    return {
        **dict.fromkeys(PULL_EFFECTS, onset),
        **dict.fromkeys(TYRE_EFFECTS, loss),
        "motor_power_limit": {"coasting": drive["coasting"]},
        "top_speed": drive,
    }


def _servo_options(make: Make) -> dict[str, dict[str, Any]]:
    lag = {"lag": measured_steering_lag(make)}
    return dict.fromkeys(SERVO_EFFECTS, lag)


def _tyre_options(make: Make, dimensions: VehicleDimensions) -> dict[str, dict[str, Any]]:
    lone = make(1)
    simulated = getattr(lone, "vehicle", lambda: dimensions)()
    declared = getattr(lone, "values", {}).get("front_drive_share")
    front = 0.0 if declared is None else round(float(declared.mean()), 6)
    tyres = measured_tyres(make, simulated, front)
    stiffness = {"stiffness": tyres["stiffness"]}
    shipped = asdict(VehicleDimensions())
    other = {k: v for k, v in asdict(simulated).items() if v != shipped[k]}
    if other:  # forces are read off with the inertia and the axles that the simulator has
        tyres |= {"dimensions": other}
    if front:
        tyres |= {"front_drive_share": front}
    return {name: tyres for name in TYRE_EFFECTS} | {name: stiffness for name in YAW_EFFECTS}


def measurable_options(make: Make) -> tuple[dict[str, dict[str, Any]], list[str]]:
    """Options as far as a simulator shows them, and in words what it does not show.

    A simulator that was never taught to slide, such as a learned one, has no tyre law to be read
    off; its effects keep the defaults of their classes.
    """
    parts = {
        "drive": lambda: _drive_options(make),
        "servo": lambda: _servo_options(make),
        "tyres": lambda: _tyre_options(make, VehicleDimensions()),
    }
    # What is not measured is the defaults of the effects' classes, but for this.
    options: dict[str, dict[str, Any]] = {n: {"stiffness": [*TYPICAL]} for n in YAW_EFFECTS}
    failures = []
    for part, measured in parts.items():
        try:
            _add(options, measured())
        except ValueError as error:
            failures.append(f"{part} cannot be measured ({error}): what is typical is assumed")
    return options, failures
