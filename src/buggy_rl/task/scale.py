"""The task at the size of a car: bounds beside the path, speeds and limits."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from buggy_rl.core.car_file import load_car
from buggy_rl.core.vehicle import Similarity
from buggy_rl.task.config import TaskConfig, TransformConfig
from buggy_rl.task.transforms.observation import TRAINED_HIGH, TRAINED_LOW

VELOCITY = ("m/s", "m/s", "rad/s")
UNITS: dict[str, dict[str, tuple[Any, Any]]] = {
    # transform -> option -> the buggy's default and its unit
    "waypoints": {"lateral_bound": (0.5, "m"), "start_lateral": (0.0, "m")},
    "leave_path": {"limit": (1.0, "m")},
    "target_speed": {"low": (1.0, "m/s"), "high": (3.0, "m/s")},
    "clip_velocity": {"low": (TRAINED_LOW, VELOCITY), "high": (TRAINED_HIGH, VELOCITY)},
}
"""Options with a length or a speed; tests hold the defaults against those of the classes."""
PER_UNIT = {"progress": "m", "deviation": "m", "speed_error": "m/s"}
"""Terms of the reward with a unit, whose weights are divided by its scale."""


def scaled_task(task: TaskConfig) -> TaskConfig:
    """A task whose transforms are scaled to the car of its paths; without one, itself.

    What a config states is the buggy's, and is scaled as the defaults are: paths scale themselves.
    """
    if not task.paths.car:
        return task
    scale = load_car(task.paths.car).similarity
    transforms = {place: _scaled(t, scale) for place, t in task.transforms.items()}
    return replace(task, transforms=transforms)


def _scaled(transform: TransformConfig, scale: Similarity) -> TransformConfig:
    options = dict(transform.options)
    for option, (default, unit) in UNITS.get(transform.name, {}).items():
        options[option] = _times(options.get(option, default), unit, scale)
    if transform.name == "rewards" and "weights" in options:
        options["weights"] = _weights(options["weights"], scale)
    return replace(transform, options=options)


def _times(value: Any, unit: Any, scale: Similarity) -> Any:
    if isinstance(unit, str):
        return scale.of(unit) * value
    return [scale.of(each) * number for number, each in zip(value, unit, strict=True)]


def _weights(weights: Mapping[str, float], scale: Similarity) -> dict[str, float]:
    return {
        name: weight / scale.of(PER_UNIT[name]) if name in PER_UNIT else weight
        for name, weight in weights.items()
    }
