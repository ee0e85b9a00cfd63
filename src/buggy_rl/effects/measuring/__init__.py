"""Identification of the properties of a simulator that effects take as options.

A simulator may be a black box, but its motion can be imposed: held at a velocity until its delays
have settled, its next step shows the forces.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

from torchrl.envs import EnvBase

from buggy_rl.core.longitudinal import declared_by
from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.effects import effect_class, offered
from buggy_rl.effects.measuring.commands import measured_command, measured_steering_lag
from buggy_rl.effects.measuring.drive import Make, measured_motor
from buggy_rl.effects.measuring.geometry import measured_dimensions
from buggy_rl.effects.measuring.tyres import measured_tyres
from buggy_rl.effects.motion.base import LOCK, TYPICAL_STIFFNESS
from buggy_rl.effects.terms.grammar import BANK, KINDS, SLOTS

LOCKS = {
    **dict.fromkeys(("lock_left", "lock_right", "steering_left", "steering_right")),
    **{"left_angle": "left_steepness", "right_angle": "right_steepness"},
}
"""Parameters of our engines that are the road-wheel angle at full command [rad], or its asymptote
in tanh(steepness command) -> that steepness."""
BEYOND = 1.15  # [-] of the lock: trim, and the more turned inner wheel; chosen

BANKS = tuple(f"{BANK}{kind}.{slot}" for kind in KINDS for slot in range(SLOTS))
"""Banks of terms, which take options like any effect."""

Options = dict[str, dict[str, Any]]
"""Options by the effect's name, as `make_effect` takes them."""

Apart = Callable[[Callable[..., Any], Sequence[tuple[Any, ...]]], list[Any]]
"""Calls a function with each of several tuples of arguments."""


def in_turn(function: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> list[Any]:
    """Results of a function for each tuple of arguments, one after the other."""
    return [function(*each) for each in arguments]


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
    car, names = _dimensions(make, dimensions), [*offered(declared_by(make(1))), *BANKS]
    options: Options = {}
    for chain in CHAINS:
        known: dict[str, Any] = {}
        for part in chain:
            known |= _PARTS[part](make, car, known)
        _assign(options, names, known)
    return options


def measurable_options(
    make: Make,
    apart: Apart = in_turn,
    typical: VehicleDimensions | None = None,
    lock: float | None = None,
) -> tuple[Options, list[str]]:
    """Options as far as the simulator shows them, and in words what it does not show.

    A simulator whose data hold no slides, such as a learned one, shows no tyre law; its effects
    keep the defaults of their classes, and yaw damping by tyres is that of `TYPICAL_STIFFNESS`.

    Args:
        make: Builds the simulator for a number of environments.
        apart: Calls a function with each of several arguments; beside each other where it can.
        typical: Of the car, where its file says; where no step shows them, they are taken.
        lock: Largest road-wheel angle of the car [rad], where its file says.
    """
    failures, names = [], [*offered(declared_by(make(1))), *BANKS]
    try:
        car = _dimensions(make, typical or VehicleDimensions())
    except ValueError as error:
        whose = "the buggy" if typical is None else "the car's file"
        failures.append(f"axles cannot be measured ({error}): those of {whose} are assumed")
        car = typical or VehicleDimensions()
    options: Options = {
        name: {"stiffness": [*TYPICAL_STIFFNESS]}
        for name in names
        if "stiffness" in _taken(name) and "friction" not in _taken(name)
    }
    _assign(options, names, _lock(lock))
    measured = apart(partial(_tried, make, car), [(chain,) for chain in CHAINS])
    for part, found in [each for chain in measured for each in chain]:
        if isinstance(found, str):
            failures.append(f"{part} cannot be measured ({found}): what is typical is assumed")
        else:
            _assign(options, names, found)
    return options, failures


def _tried(
    make: Make, car: VehicleDimensions, chain: Sequence[str]
) -> list[tuple[str, dict[str, Any] | str]]:
    """What each part of a chain measures, or why it cannot."""
    results: list[tuple[str, dict[str, Any] | str]] = []
    known: dict[str, Any] = {}
    for part in chain:
        try:
            found = _PARTS[part](make, car, known)
        except ValueError as error:
            results.append((part, str(error)))
        else:
            known |= found
            results.append((part, found))
    return results


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
    """Dimensions of the simulator: as it says itself, or else as its steps show."""
    says = getattr(make(1), "vehicle", None)
    return measured_dimensions(make, typical) if says is None else says()


def _body(car: VehicleDimensions) -> dict[str, Any]:
    shipped = asdict(VehicleDimensions())
    other = {k: v for k, v in asdict(car).items() if v != shipped[k]}
    return {"dimensions": other} if other else {}


def _lock(lock: float | None) -> dict[str, Any]:
    """Largest road-wheel angle, where a car turns its wheels further than the effects allow for."""
    return {} if lock is None or BEYOND * lock <= LOCK else {"lock": round(BEYOND * lock, 4)}


def _declared_lock(make: Make) -> float | None:
    """Steering lock of a simulator that declares its steering; None for any other."""
    values = getattr(make(1), "values", {})
    locks = [
        float((values[name] * (values[bend].tanh() if bend else 1.0)).max())
        for name, bend in LOCKS.items()
        if name in values
    ]
    return max(locks, default=None)


def front_drive_share(simulator: EnvBase) -> float:
    """Share of the drive in front, of a simulator that declares it; 0 for any other."""
    declared = getattr(simulator, "values", {}).get("front_drive_share")
    return 0.0 if declared is None else round(float(declared.mean()), 6)


def _tyres(make: Make, car: VehicleDimensions, coasting: Sequence[float] | None) -> dict[str, Any]:
    front = front_drive_share(make(1))
    tyres = measured_tyres(make, car, front, coasting)
    return tyres | ({"front_drive_share": front} if front else {})


_PARTS: dict[str, Callable[[Make, VehicleDimensions, Mapping[str, Any]], dict[str, Any]]] = {
    "drive": lambda make, car, known: measured_motor(make),
    "tyres": lambda make, car, known: _tyres(make, car, known.get("coasting")),
    "servo": lambda make, car, known: {"lag": measured_steering_lag(make)},
    "body": lambda make, car, known: _body(car) | _lock(_declared_lock(make)),
    "command": lambda make, car, known: measured_command(make),
}
"""What a simulator shows, each of its car and of what the parts before it in the chain showed."""

CHAINS = (("drive", "tyres"), ("servo", "body", "command"))
"""Chains of parts. Those of one follow each other: tyres need the drive's coasting."""
