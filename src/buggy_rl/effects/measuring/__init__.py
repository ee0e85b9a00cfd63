"""Identification of the properties of a simulator that effects take as options.

A simulator may be a black box, but its motion can be imposed: held at a velocity until its delays
have settled, its next step shows the forces.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import cache
from typing import Any

from buggy_rl.effects import effect_class, offered
from buggy_rl.effects.measuring.commands import measured_command
from buggy_rl.effects.measuring.drive import measured_drive, measured_onset
from buggy_rl.effects.measuring.geometry import measured_dimensions
from buggy_rl.effects.measuring.holding import Make
from buggy_rl.effects.measuring.servo import measured_steering_lag
from buggy_rl.effects.measuring.tyres import measured_tyres
from buggy_rl.longitudinal import declared_by
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
        dimensions: From which those of a simulator that does not say its own are fitted, and which
            are kept where no step shows them; or those that differ from the buggy's.

    Raises:
        ValueError: A velocity of the simulator is not finite, or a property does not show.
    """
    if not isinstance(dimensions, VehicleDimensions):
        dimensions = VehicleDimensions(**(dimensions or {}))
    car, names = _dimensions(make, dimensions), offered(declared_by(make(1)))
    options: Options = {}
    drive = measured_drive(make)
    parts = (
        drive,
        {"onset": measured_onset(make)},
        {"lag": measured_steering_lag(make)},
        _body(car),
        _tyres(make, car, drive["coasting"]),
        measured_command(make),
    )
    for measured in parts:
        _assign(options, names, measured)
    return options


def measurable_options(make: Make) -> tuple[Options, list[str]]:
    """Options as far as the simulator shows them, and in words what it does not show.

    A simulator whose data hold no slides, such as a learned one, shows no tyre law; its effects
    keep the defaults of their classes, and yaw damping by tyres is that of `TYPICAL_STIFFNESS`.
    """
    failures, names = [], offered(declared_by(make(1)))
    try:
        car = _dimensions(make, VehicleDimensions())
    except ValueError as error:
        failures.append(f"axles cannot be measured ({error}): those of the buggy are assumed")
        car = VehicleDimensions()
    driven = cache(lambda: measured_drive(make))
    parts = {
        "drive": lambda: driven() | {"onset": measured_onset(make)},
        "servo": lambda: {"lag": measured_steering_lag(make)},
        "body": lambda: _body(car),
        "tyres": lambda: _tyres(make, car, driven()["coasting"]),
        "command": lambda: measured_command(make),
    }
    options: Options = {
        name: {"stiffness": [*TYPICAL_STIFFNESS]}
        for name in names
        if "stiffness" in _taken(name) and "friction" not in _taken(name)
    }
    for part, measured in parts.items():
        try:
            _assign(options, names, measured())
        except ValueError as error:
            failures.append(f"{part} cannot be measured ({error}): what is typical is assumed")
    return options, failures


def _taken(name: str) -> set[str]:
    """Options of an effect that can be measured."""
    kind = effect_class(name)
    # Forces act at the centre of gravity of the simulator, with its inertia and its axles.
    own = {"dimensions"} if kind.kind == "motion" else set()
    return {*kind.option_names, "rest"} | own


def _assign(options: Options, names: list[str], measured: Mapping[str, Any]) -> None:
    """Adds measured properties to the options of each of the effects that takes them."""
    for name in names:
        own = {key: value for key, value in measured.items() if key in _taken(name)}
        if own:
            options.setdefault(name, {}).update(own)


def _dimensions(make: Make, typical: VehicleDimensions) -> VehicleDimensions:
    """Of the simulator: as it says itself, or else as its steps show."""
    says = getattr(make(1), "vehicle", None)
    return measured_dimensions(make, typical) if says is None else says()


def _body(car: VehicleDimensions) -> dict[str, Any]:
    shipped = asdict(VehicleDimensions())
    other = {k: v for k, v in asdict(car).items() if v != shipped[k]}
    return {"dimensions": other} if other else {}


def _tyres(make: Make, car: VehicleDimensions, coasting: Sequence[float]) -> dict[str, Any]:
    declared = getattr(make(1), "values", {}).get("front_drive_share")
    front = 0.0 if declared is None else round(float(declared.mean()), 6)
    tyres = measured_tyres(make, car, front, coasting)
    return tyres | ({"front_drive_share": front} if front else {})
