"""A simulator ready to be compared: what it declares, what it may lack, what effects must know."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from buggy_rl.core.car_file import load_car
from buggy_rl.core.longitudinal import declared_by
from buggy_rl.core.vehicle import Similarity, VehicleDimensions
from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.diagnosis.run.drives import Drives
from buggy_rl.effects import OF_A_COLUMN, offered
from buggy_rl.effects.measuring import in_turn, measurable_options
from buggy_rl.estimation.body import body_of, bounded_by
from buggy_rl.estimation.hypothesis import Library
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.task.augment import effects_of


@dataclass(frozen=True, eq=False)
class Opened:
    """A simulator, and the library that is compared with it."""

    simulation: Simulation
    """Simulation with what effects must know of the simulator."""
    library: Library
    """What the simulator may lack, or have wrong."""
    notes: list[str]


def measured(
    config: DiagnosisConfig, simulation: Simulation, drives: Drives, seconds: float = 0.0
) -> Opened:
    """Measures what effects must know of a simulator.

    Args:
        config: The question.
        simulation: Of the simulator.
        drives: What it is compared with.
        seconds: That a chain of its steps is expected to take; for little, no process is started.
    """
    make, apart = simulation.make, partial(simulation.workers.results, seconds=seconds)
    own = drives.baseline is None if config.parameters is None else config.parameters
    inside = [effect.name for effect in effects_of(make(1))]
    black_box = config.parameters is False
    realises = {} if black_box else getattr(make(1), "realises", {})
    declared = getattr(make(1), "declared", {}) if own or realises else {}
    declared = {name: bounded_by(body_of(make(1)), p) for name, p in declared.items()}
    derived = set.intersection(*(set(r.derived) for r in drives.recordings))
    names = config.effects or offered(declared_by(make(1)), derived)
    scale = _similarity(config, make)
    library = Library([e for e in names if e not in inside], declared, own, realises, scale)
    options, notes = measurable_options(make, apart, *_of_the_file(config))
    left_out = [n for n, column in OF_A_COLUMN.items() if column in derived]
    if left_out and not config.effects:
        notes.append(
            f"{', '.join(sorted(derived))} follow from the pose in all recordings: "
            f"{', '.join(left_out)} cannot be told and are not looked for"
        )
    return Opened(replace(simulation, options=options), library, notes)


def measured_again(
    config: DiagnosisConfig, given: Simulation, make: Callable[[int], Any], library: Library
) -> Opened:
    """A simulator whose own parameters were fitted: what effects must know of it is measured anew.

    Args:
        config: The question.
        given: Of the simulator as it was given.
        make: Builds the re-tuned one.
        library: Of the simulator as it was given.
    """
    options, notes = measurable_options(make, in_turn, *_of_the_file(config))
    declared = getattr(make(1), "declared", {})
    library = Library(library.effects, declared, own=False, similarity=library.similarity)
    return Opened(replace(given, make=make, options=options), library, notes)


def _of_the_file(config: DiagnosisConfig) -> tuple[VehicleDimensions | None, float | None]:
    """Dimensions and largest road-wheel angle [rad] of the car, where a file says them."""
    if not config.car:
        return None, None
    car = load_car(config.car)
    locks = [angle for angle in (car.steering.left, car.steering.right) if angle]
    return car.vehicle, max(locks, default=None)


def _similarity(config: DiagnosisConfig, make: Callable[[int], Any]) -> Similarity:
    """Ratios of the car to the buggy; without a car's file those of the simulator."""
    if config.car:
        return load_car(config.car).similarity
    return getattr(make(1), "similarity", Similarity())
