"""Plants: the simulated true cars of blind tests, of four kinds of physics, each with faults."""

from collections.abc import Mapping
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # at run time a name costs no two seconds of torchrl
    from torchrl.envs import EnvBase

PLANTS: tuple[str, ...] = ("reference", "mujoco", "commonroad", "rally")


def abilities(plant: str) -> frozenset[str]:
    """Names of the effects that a plant's physics can have; sensing errors are the camera's.

    Raises:
        ValueError: There is no such plant.
    """
    return _module(plant).ABILITIES


def make_plant(
    plant: str,
    cars: int,
    faults: Mapping[str, Mapping[str, float]],
    parameters: Mapping[str, float] | None = None,
) -> "EnvBase":
    """Equal cars of one kind of physics, with faults.

    Args:
        plant: One of `PLANTS`.
        cars: Number of environments.
        faults: `{effect: {parameter: value}}`, each effect one of its `abilities`.
        parameters: Of the plant's physics, where they differ from its own.

    Raises:
        ValueError: There is no such plant, or a fault is outside its range.
        KeyError: The plant has no such effect, or no such parameter.
        ModuleNotFoundError: The plant's library is not installed; the message says how to.
    """
    return getattr(_module(plant), f"make_{plant}")(cars, faults, parameters)


def _module(plant: str):
    if plant not in PLANTS:
        raise ValueError(f"no plant {plant!r}; available: {', '.join(PLANTS)}")
    return import_module(f"buggy_rl.proof.plants.{plant}")
