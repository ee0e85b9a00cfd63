"""The task as a stack of transforms, each by name."""

import inspect
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from buggy_rl.core import trust
from buggy_rl.core.config import load_named, one_line
from buggy_rl.core.option_values import nearest

if TYPE_CHECKING:  # at run time a name costs no two seconds of torchrl
    from torchrl.envs import Transform

TRANSFORMS = {
    "last_action": "buggy_rl.task.transforms.commands:LastAction",
    "action_smoothing": "buggy_rl.task.transforms.commands:ActionSmoothing",
    "rate_limit": "buggy_rl.task.transforms.commands:RateLimit",
    "observation_noise": "buggy_rl.task.transforms.observation:ObservationNoise",
    "past_mean": "buggy_rl.task.transforms.observation:PastMean",
    "clip_velocity": "buggy_rl.task.transforms.observation:ClipVelocity",
    "waypoints": "buggy_rl.task.transforms.waypoints:Waypoints",
    "target_speed": "buggy_rl.task.transforms.waypoints:TargetSpeed",
    "observation": "buggy_rl.task.transforms.observation:Observation",
    "history": "buggy_rl.task.transforms.observation:History",
    "leave_path": "buggy_rl.task.transforms.rewards:LeavePath",
    "path_end": "buggy_rl.task.transforms.rewards:PathEnd",
    "rewards": "buggy_rl.task.transforms.rewards:Rewards",
    "step_limit": "torchrl.envs:StepCounter",
}


def make_transform(
    name: str, options: Mapping[str, Any] | None = None, **context: Any
) -> "Transform":
    """Builds a transform from what a user can write in YAML.

    Args:
        name: In `TRANSFORMS`, or one's own or TorchRL's as `path/to/file.py:Class` or
            `package.module:Class`.
        options: Arguments of the class.
        context: Further arguments, such as `paths` and `dt`, for the classes that take them.

    Raises:
        ValueError: The name is unknown or no transform's, an option does not belong to it (the
            message lists those that do) or is missing, or TorchRL's transform is wrong in a task.
    """
    from torchrl.envs import Transform

    from buggy_rl.task.transforms.foreign import refuse_wrong

    if name not in TRANSFORMS and ":" not in name:
        raise ValueError(
            f"no transform {name!r}; {nearest(name, TRANSFORMS)}available: "
            f"{', '.join(TRANSFORMS)}, none, or your own as file.py:Class"
        )
    transform_class = load_named(TRANSFORMS.get(name, name))
    trust.refuse_other_class(transform_class, Transform, name)
    refuse_wrong(transform_class, options or {})
    takes = inspect.signature(transform_class).parameters
    kinds = {parameter.kind: key for key, parameter in takes.items()}
    unknown = sorted(set(options or {}) - set(takes))
    if unknown and inspect.Parameter.VAR_KEYWORD not in kinds:
        allowed = sorted(set(takes) - set(context))
        raise ValueError(
            f"transform {name!r} has no option {', '.join(unknown)}; "
            f"available: {', '.join(allowed) or 'none'}"
        )
    given = {key: value for key, value in context.items() if key in takes}
    given.update(options or {})
    several = given.pop(kinds.get(inspect.Parameter.VAR_POSITIONAL, ""), ())  # *keys, as a list
    try:
        return transform_class(*several, **given)
    except (TypeError, RuntimeError) as error:
        raise ValueError(f"transform {name!r}: {one_line(error)}") from error
