"""The reference car as a plant, with all faults of the engine, textbook and unknown."""

from collections.abc import Mapping

from buggy_rl.core.longitudinal import LongitudinalCommand
from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.simulators.reference import ReferenceEngine
from buggy_rl.simulators.reference.faults import COMMAND_OF, TEXTBOOK, UNKNOWN, effect_of

ABILITIES = frozenset(effect_of(fault.name) for fault in (*TEXTBOOK, *UNKNOWN))


def abilities_of(command: LongitudinalCommand) -> frozenset[str]:
    """Effects that the car can have with a kind of command, beside the one-way car's."""
    return frozenset(effect for effect, kind in COMMAND_OF.items() if kind == command.kind)


def make_reference(
    cars: int,
    faults: Mapping[str, Mapping[str, float]],
    parameters: Mapping[str, float] | None,
    command: str | LongitudinalCommand = "throttle",
    dimensions: VehicleDimensions | None = None,
) -> ReferenceEngine:
    """Reference cars with faults; see `buggy_rl.simulators.reference.faults`."""
    return ReferenceEngine(
        cars, parameters=parameters, faults=faults, command=command, dimensions=dimensions
    )
