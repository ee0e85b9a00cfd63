"""An engine, missing physics and the task, put together: one environment.

One line swaps one transform, here or in YAML (`configs/task_waypoints.yaml`):

    from buggy_rl.config import build
    from buggy_rl.task.env import TaskConfig, make_env

    task = build(TaskConfig, ["configs/task_waypoints.yaml", "transforms.command.name=none"])
    env = make_env("mujoco", task=task, batch_size=64)
    print(env.rollout(100)["next", "reward"].sum())
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from torchrl.envs import Compose, EnvBase, Transform, TransformedEnv

from buggy_rl.effects import make_effects
from buggy_rl.engines import make_engine, read_simulator
from buggy_rl.task.paths.making import PathConfig, make_paths
from buggy_rl.task.paths.path_set import PathSet
from buggy_rl.task.transforms import make_transform
from buggy_rl.vehicle import CONTROL_PERIOD


@dataclass(frozen=True)
class TransformConfig:
    """One transform of the stack."""

    name: str = "none"
    """A name in `TRANSFORMS`, one's own as file.py:Class, or none."""
    options: dict[str, Any] = field(default_factory=dict)
    """Arguments of its class."""
    before: str = ""
    """Place that it stands before, for a place of one's own; empty for the end of the stack."""


def default_transforms() -> dict[str, TransformConfig]:
    """The stack by place, from the engine outwards.

    The order that must hold: what shapes the command is passed from the far end inwards, so
    `last_action` stands nearer to the engine than what it should see the result of. Sensing goes
    noise, filter, clip, as on the car, and before what shows it. `waypoints` before what reads
    them; whatever is to be seen before `observation`, and `history` right after it. What
    terminates before the rewards, which may count it, and both before the step limit, which
    closes `done`. A transform that cannot work where it stands says so when the stack is built.
    """
    return {
        "last_action": TransformConfig("last_action"),
        "command": TransformConfig(),
        "noise": TransformConfig(),
        "filter": TransformConfig(),
        "clip": TransformConfig("clip_velocity"),
        "waypoints": TransformConfig("waypoints"),
        "target_speed": TransformConfig(),
        "observation": TransformConfig("observation"),
        "history": TransformConfig(),
        "leave_path": TransformConfig("leave_path"),
        "path_end": TransformConfig("path_end"),
        "rewards": TransformConfig("rewards"),
        "step_limit": TransformConfig("step_limit", {"max_steps": 1000}),
    }


@dataclass(frozen=True)
class TaskConfig:
    """What a car is to do, whatever moves it."""

    paths: PathConfig = field(default_factory=PathConfig)
    transforms: dict[str, TransformConfig] = field(default_factory=default_transforms)
    """By place: last_action, command, noise, filter, clip, waypoints, target_speed, observation,
    history, leave_path, path_end, rewards, step_limit, or a place of one's own."""


def make_simulator(
    simulator: str | Path,
    batch_size: int | Sequence[int] = (),
    device: str = "cpu",
    parameters: Mapping[str, float] | None = None,
    **options: Any,
) -> EnvBase:
    """Builds an engine, or one with missing physics put into it (`effects:` of a .yaml file).

    Args:
        simulator: As for `make_engine`.
        batch_size: Likewise.
        device: Likewise.
        parameters: Likewise.
        options: Likewise.

    Raises:
        ValueError: A name is unknown; the message lists the known ones.
    """
    if not str(simulator).endswith((".yaml", ".yml")):
        return make_engine(simulator, batch_size, device, parameters, **options)
    content = read_simulator(Path(simulator))
    merged = {**content["parameters"], **(parameters or {})}
    settings = {**content["options"], **options}
    engine = make_simulator(content["engine"], batch_size, device, merged or None, **settings)
    return with_effects(engine, make_effects(content["effects"]))


def with_effects(engine: EnvBase, effects: Sequence[Transform]) -> EnvBase:
    """Puts missing physics over an engine, from the engine outwards; without any, it is itself."""
    if not effects:
        return engine
    env = TransformedEnv(engine, Compose([]), auto_unwrap=True)
    for effect in effects:
        env.append_transform(effect)
    return env


def make_env(
    engine: EnvBase | str | Path,
    effects: Sequence[Transform] = (),
    task: TaskConfig | None = None,
    batch_size: int | Sequence[int] = (),
    device: str = "cpu",
    paths: PathSet | None = None,
) -> TransformedEnv:
    """Puts missing physics and a task over an engine.

    Args:
        engine: A simulator, or what `make_simulator` makes one of.
        effects: Missing physics, from the engine outwards.
        task: What to do; None is the original study's task, made sound.
        batch_size: Number of cars or a shape, for an engine that is still to be made.
        device: Likewise.
        paths: To follow instead of `task.paths`.

    Raises:
        ValueError: A transform is unknown, or stands where it cannot work.
    """
    task = task or TaskConfig()
    if not isinstance(engine, EnvBase):
        engine = make_simulator(engine, batch_size, device)
    # Over a simulator that is itself an engine with transforms, one stack grows from theirs.
    env = TransformedEnv(engine, Compose([]), auto_unwrap=True)
    context = {
        "paths": make_paths(task.paths) if paths is None else paths,
        "dt": getattr(engine, "dt", CONTROL_PERIOD),
    }
    stack = [make_transform(c.name, c.options, **context) for c in in_order(task.transforms)]
    for transform in (*effects, *stack):
        env.append_transform(transform)
    _ = env.output_spec  # a transform that stands in a wrong place says so here
    return env


def judged(transforms: dict[str, TransformConfig]) -> dict[str, TransformConfig]:
    """The stack in which drivers are compared: a path for each car, all set down at its start."""
    waypoints = transforms["waypoints"]
    exact = {"order": "fixed", "start_lateral": 0.0, "start_heading": 0.0}
    options = {**waypoints.options, **exact}
    return {**transforms, "waypoints": replace(waypoints, options=options)}


def in_order(transforms: dict[str, TransformConfig]) -> list[TransformConfig]:
    """The transforms that are there, from the engine outwards.

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
    return [transforms[place] for place in places if transforms[place].name != "none"]
