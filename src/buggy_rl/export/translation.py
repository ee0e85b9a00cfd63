"""The task of a policy -> what the car's runtime has to do of it, as plain values."""

from collections.abc import Callable, Sequence
from typing import Any

from torchrl.envs import StepCounter, Transform

from buggy_rl.car.observation import INPUTS, quantities
from buggy_rl.task.config import TaskConfig, places_in_order
from buggy_rl.task.paths.path_set import PathSet
from buggy_rl.task.transforms import make_transform
from buggy_rl.task.transforms.commands import ActionSmoothing, LastAction, RateLimit
from buggy_rl.task.transforms.observation import (
    ClipVelocity,
    History,
    Observation,
    ObservationNoise,
    PastMean,
)
from buggy_rl.task.transforms.rewards import LeavePath, PathEnd, Rewards
from buggy_rl.task.transforms.waypoints import TargetSpeed, Waypoints

LEFT_OUT = {  # what is only there for training, and why the car goes without
    ObservationNoise: "the car's sensor has noise of its own",
    Rewards: "nothing is learned on the car",
    StepCounter: "the car's runtime has a longest time of its own",
    PathEnd: "the car's runtime says where the path is completed",
}
SENSING: dict[type, Callable[[Any], dict[str, Any]]] = {
    PastMean: lambda t: {"name": "past_mean", "width": t.width},
    ClipVelocity: lambda t: {
        "name": "clip_velocity",
        "low": t.low.tolist(),
        "high": t.high.tolist(),
    },
}
COMMANDS: dict[type, Callable[[Any], dict[str, Any]]] = {
    LastAction: lambda t: {"name": "last_action"},
    ActionSmoothing: lambda t: {"name": "action_smoothing", "share": t.share},
    RateLimit: lambda t: {"name": "rate_limit", "largest": t.largest.tolist()},
}


def runtime_task(
    task: TaskConfig, paths: PathSet, dt: float, training_only: Sequence[str] = ()
) -> dict[str, Any]:
    """What the runtime does of a task: the parts of a policy's JSON that are the task's.

    Args:
        task: That the policy was trained on.
        paths: Any.
        dt: Control period [s].
        training_only: Places to leave out, beside what is known to matter in training alone.

    Raises:
        ValueError: The runtime does not know a transform or an input of the observation.
    """
    context = {"paths": paths, "dt": dt}
    stack = [
        (
            place,
            make_transform(task.transforms[place].name, task.transforms[place].options, **context),
        )
        for place in places_in_order(task.transforms)
    ]
    _refuse_unknown_places(training_only, [place for place, _ in stack])
    asked = [(place, transform) for place, transform in stack if place not in training_only]
    transforms = [transform for _, transform in asked]
    _refuse_unknown_transforms(asked)
    row = _only(transforms, Observation)
    waypoints = _only(transforms, Waypoints)
    if row is None or waypoints is None:
        raise ValueError("the task has no waypoints or no observation: the car has nothing to see")
    speed, leave = _only(transforms, TargetSpeed), _only(transforms, LeavePath)
    return {
        "control_period": dt,
        "sensing": [SENSING[type(t)](t) for t in transforms if type(t) in SENSING],
        "waypoints": {
            "visible": waypoints.visible,
            "lateral_bound": waypoints.lateral_bound,
            "at_once": waypoints.at_once,
        },
        "target_speed": None if speed is None else {"low": speed.low, "high": speed.high},
        "observation": _observation(row, _only(transforms, History), waypoints.visible),
        # A command passes the stack from its end to the engine.
        "commands": [COMMANDS[type(t)](t) for t in reversed(transforms) if type(t) in COMMANDS],
        "leave_path": None if leave is None else leave.limit,
        "left_out": [_left_out(place, transform, training_only) for place, transform in stack
                     if place in training_only or type(transform) in LEFT_OUT],
    }  # fmt: skip


def _observation(row: Any, history: Any, visible: int) -> dict[str, Any]:
    known = {*INPUTS, "waypoints"}
    unknown = [key for key in row.inputs if key not in known]
    if unknown:
        raise ValueError(
            f"observation: the car has no {', '.join(unknown)}; train with inputs out of "
            f"{', '.join(sorted(known))}"
        )
    numbers = [{"name": name, "unit": unit} for name, unit in quantities(row.inputs, visible)]
    rows = 1 if history is None else history.rows
    return {"inputs": list(row.inputs), "rows": rows, "numbers": numbers}


def _only(transforms: Sequence[Transform], kind: type) -> Any:
    found = [transform for transform in transforms if type(transform) is kind]
    if len(found) > 1:
        raise ValueError(f"{kind.__name__} stands {len(found)} times in the task: leave one")
    return found[0] if found else None


def _refuse_unknown_transforms(stack: Sequence[tuple[str, Transform]]) -> None:
    known = {*LEFT_OUT, *SENSING, *COMMANDS}
    known |= {Waypoints, Observation, TargetSpeed, History, LeavePath}
    for place, transform in stack:
        if type(transform) not in known:
            raise ValueError(
                f"task.transforms.{place}: the car's runtime does not know "
                f"{type(transform).__name__}; train without it, write it in buggy_rl/car and in "
                "export/translation.py, or, if it changes neither observation nor "
                f"command, export with training_only=[{place}]"
            )


def _refuse_unknown_places(training_only: Sequence[str], places: Sequence[str]) -> None:
    unknown = [place for place in training_only if place not in places]
    if unknown:
        raise ValueError(
            f"training_only: no place {', '.join(unknown)} in the task; it has {', '.join(places)}"
        )


def _left_out(place: str, transform: Transform, training_only: Sequence[str]) -> dict[str, str]:
    why = "named in training_only" if place in training_only else LEFT_OUT[type(transform)]
    return {"place": place, "name": type(transform).__name__, "why": why}
