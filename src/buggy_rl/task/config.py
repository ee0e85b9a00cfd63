"""The task on a page: paths, and the whole default stack of transforms in its order."""

from dataclasses import dataclass, field, replace
from typing import Any

from buggy_rl.core.config import belongs_to
from buggy_rl.task.paths.making import PathConfig


@dataclass(frozen=True)
class TransformConfig:
    """One transform of the stack."""

    name: str = "none"
    """A name in `TRANSFORMS`, one's own as file.py:Class, or none."""
    options: dict[str, Any] = field(default_factory=dict, metadata=belongs_to("name"))
    """Arguments of its class; a config layer that names another transform drops them."""
    before: str = ""
    """Place that it stands before, for a place of one's own; empty for the end of the stack."""

    def __post_init__(self) -> None:
        if self.name == "none" and self.options:
            raise ValueError(
                f"task: options {', '.join(self.options)} are given to a place without a "
                "transform: name it too, transforms.PLACE.name=..."
            )


def default_transforms() -> dict[str, TransformConfig]:
    """The stack by place, from the engine outwards.

    Constraints on the order, checked when the stack is built:

    1. A command passes the stack from its end to the engine, so `last_action` stands nearer to the
       engine than the filters whose result it records.
    2. Sensing is noise, filter, clip, as on the car, before `waypoints` and `observation`.
    3. `waypoints` precedes everything that reads its keys.
    4. What a policy sees precedes `observation`; `history` follows it.
    5. Termination precedes `rewards`, which may count it; the step limit, which completes `done`,
       is last.
    """
    return {
        "last_action": TransformConfig("last_action"),  # the command, kept for rewards
        "command": TransformConfig(),  # a filter of commands: action_smoothing or rate_limit
        "noise": TransformConfig(),  # noise of the sensor: observation_noise
        "filter": TransformConfig(),  # the filter that runs on the car: past_mean
        "clip": TransformConfig("clip_velocity"),  # to the learned model's range
        "waypoints": TransformConfig("waypoints"),  # next ones, closed ones, errors
        "target_speed": TransformConfig(),  # a speed to keep, drawn at a reset: target_speed
        "observation": TransformConfig("observation"),  # 23 numbers: velocity, waypoints
        "history": TransformConfig(),  # the last rows instead of one: history
        "leave_path": TransformConfig("leave_path"),  # terminated more than 1 m beside the path
        "path_end": TransformConfig("path_end"),  # truncated at the end of an open path
        "rewards": TransformConfig("rewards"),  # 1 for each waypoint closed
        "step_limit": TransformConfig("step_limit", {"max_steps": 1000}),  # truncated after 10 s
    }


@dataclass(frozen=True)
class TaskConfig:
    """The task of a car, independent of the engine."""

    paths: PathConfig = field(default_factory=PathConfig)
    transforms: dict[str, TransformConfig] = field(default_factory=default_transforms)
    """Transforms by place: last_action, command, noise, filter, clip, waypoints, target_speed,
    observation, history, leave_path, path_end, rewards, step_limit, or a place of one's own."""


def evaluation_transforms(transforms: dict[str, TransformConfig]) -> dict[str, TransformConfig]:
    """The stack in evaluation: environment i is on path i, and starts exactly where it begins."""
    waypoints = transforms["waypoints"]
    exact = {"order": "fixed", "start_lateral": 0.0, "start_heading": 0.0}
    options = {**waypoints.options, **exact}
    return {**transforms, "waypoints": replace(waypoints, options=options)}


def transforms_in_order(transforms: dict[str, TransformConfig]) -> list[TransformConfig]:
    """The transforms that are there, from the engine outwards.

    Raises:
        ValueError: One stands before a place that does not exist.
    """
    return [transforms[place] for place in places_in_order(transforms)]


def places_in_order(transforms: dict[str, TransformConfig]) -> list[str]:
    """Places of the transforms that are there, from the engine outwards.

    Raises:
        ValueError: One stands before a place that does not exist.
    """
    places = [place for place, config in transforms.items() if not config.before]
    for place, config in transforms.items():
        if config.before:
            if config.before not in places:
                raise ValueError(
                    f"task: {place!r} stands before {config.before!r}; the places are "
                    f"{', '.join(places)}"
                )
            places.insert(places.index(config.before), place)
    return [place for place in places if transforms[place].name != "none"]
