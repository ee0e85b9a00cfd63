"""Identification of the properties of a simulator that effects take as options.

A simulator may be a black box, but its motion can be imposed: held at a velocity until its delays
have settled, its next step shows the forces.
"""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from buggy_rl.effects import EFFECTS, effect_class
from buggy_rl.effects.measuring.drive import measured_drive, measured_onset
from buggy_rl.effects.measuring.holding import Make
from buggy_rl.effects.measuring.servo import measured_steering_lag
from buggy_rl.effects.measuring.tyres import measured_tyres
from buggy_rl.vehicle import VehicleDimensions

TYPICAL_STIFFNESS = (6.1, 9.4)  # [1/rad] over load, front and rear: B C D of DART's axles

Options = dict[str, dict[str, Any]]
"""Options by the effect's name, as `make_effect` takes them."""


def measured_options(
    make: Make, dimensions: VehicleDimensions | Mapping[str, float] | None = None
) -> Options:
    """Options of all effects that take some.

    Args:
        make: Builds the simulator for a number of environments.
        dimensions: Of a car whose simulator has none, or those that differ from the buggy's.

    Raises:
        ValueError: A velocity of the simulator is not finite, or a property does not show.
    """
    if not isinstance(dimensions, VehicleDimensions):
        dimensions = VehicleDimensions(**(dimensions or {}))
    options: Options = {}
    for measured in (_drive(make), _servo(make), _tyres(make, dimensions)):
        _assign(options, measured)
    return options


def measurable_options(make: Make) -> tuple[Options, list[str]]:
    """Options as far as the simulator shows them, and in words what it does not show.

    A simulator whose data hold no slides, such as a learned one, shows no tyre law; its effects
    keep the defaults of their classes, and yaw damping by tyres is that of `TYPICAL_STIFFNESS`.
    """
    parts = {
        "drive": lambda: _drive(make),
        "servo": lambda: _servo(make),
        "tyres": lambda: _tyres(make, VehicleDimensions()),
    }
    options: Options = {
        name: {"stiffness": [*TYPICAL_STIFFNESS]}
        for name in EFFECTS
        if "stiffness" in _taken(name) and "friction" not in _taken(name)
    }
    failures = []
    for part, measured in parts.items():
        try:
            _assign(options, measured())
        except ValueError as error:
            failures.append(f"{part} cannot be measured ({error}): what is typical is assumed")
    return options, failures


def _taken(name: str) -> set[str]:
    """Options of an effect that can be measured."""
    taken = set(effect_class(name).option_names)
    # Axle forces are read off with the inertia and the axles of the simulator.
    return taken | {"dimensions"} if "friction" in taken else taken


def _assign(options: Options, measured: Mapping[str, Any]) -> None:
    """Adds measured properties to the options of each effect that takes them."""
    for name in EFFECTS:
        own = {key: value for key, value in measured.items() if key in _taken(name)}
        if own:
            options.setdefault(name, {}).update(own)


def _drive(make: Make) -> dict[str, Any]:
    return measured_drive(make) | {"onset": measured_onset(make)}


def _servo(make: Make) -> dict[str, Any]:
    return {"lag": measured_steering_lag(make)}


def _tyres(make: Make, dimensions: VehicleDimensions) -> dict[str, Any]:
    simulator = make(1)
    simulated = getattr(simulator, "vehicle", lambda: dimensions)()
    declared = getattr(simulator, "values", {}).get("front_drive_share")
    front = 0.0 if declared is None else round(float(declared.mean()), 6)
    tyres = measured_tyres(make, simulated, front)
    shipped = asdict(VehicleDimensions())
    other = {k: v for k, v in asdict(simulated).items() if v != shipped[k]}
    if other:
        tyres["dimensions"] = other
    if front:
        tyres["front_drive_share"] = front
    return tyres
