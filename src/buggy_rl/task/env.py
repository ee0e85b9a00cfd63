"""One environment from an engine, missing physics and the task, at the size of its car.

One line swaps one transform, here or in YAML (`configs/task_waypoints.yaml`):

    from buggy_rl.core.config import build
    from buggy_rl.task.env import TaskConfig, make_env

    task = build(TaskConfig, ["configs/task_waypoints.yaml", "transforms.command.name=none"])
    env = make_env("mujoco", task=task, batch_size=64)
    print(env.rollout(100)["next", "reward"].sum())
"""

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from tensordict import NestedKey
from torchrl.envs import Compose, EnvBase, Transform, TransformedEnv

from buggy_rl.core import keys
from buggy_rl.core.car_file import load_car
from buggy_rl.core.config import one_line
from buggy_rl.core.longitudinal import declared_by
from buggy_rl.core.vehicle import CONTROL_PERIOD, Similarity
from buggy_rl.effects import make_effects
from buggy_rl.effects.base import Effect
from buggy_rl.simulators import Factory, make_engine, read_simulator
from buggy_rl.simulators.base import Engine
from buggy_rl.simulators.contract import refuse_stateful
from buggy_rl.simulators.serial import in_single_precision
from buggy_rl.task.config import TaskConfig, TransformConfig, transforms_in_order
from buggy_rl.task.paths.making import make_paths
from buggy_rl.task.paths.path_set import PathSet
from buggy_rl.task.stack import StackedEnv
from buggy_rl.task.transforms import make_transform
from buggy_rl.task.transforms.base import RandomTransform, TaskTransform
from buggy_rl.task.transforms.observation import TRAINED_HIGH, TRAINED_LOW
from buggy_rl.task.transforms.rewards import Endings, Rewards

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


class TaskEnv(StackedEnv):
    """An engine, missing physics and a task; `set_seed` reaches the task's random transforms."""

    def set_seed(self, seed: int | None = None, static_seed: bool = False) -> int | None:
        """Seeds engine and transforms: resets no longer depend on PyTorch's global generator.

        Args:
            seed: None gives the transforms back to the global generator.
            static_seed: Returns `seed` itself.

        Returns:
            The seed for a further environment.
        """
        generator = None
        if seed is not None:
            generator = torch.Generator(self.device or "cpu").manual_seed(seed)
        for transform in self.transform.modules():
            if isinstance(transform, RandomTransform):
                transform.generator = generator
        return super().set_seed(seed, static_seed)


def make_simulator(
    simulator: str | Path | Factory,
    /,
    batch_size: int | Sequence[int] = (),
    device: str = "cpu",
    parameters: Mapping[str, float] | None = None,
    **options: Any,
) -> EnvBase:
    """Builds an engine, or an engine with effects (`effects:` of a .yaml file), as `make_engine`.

    Raises:
        ValueError: A name is unknown, the message lists the known ones; or there is no environment.
    """
    if 0 in ((batch_size,) if isinstance(batch_size, int) else batch_size):
        raise ValueError(f"batch_size is {batch_size}: at least one environment is needed")
    if callable(simulator) or not str(simulator).endswith((".yaml", ".yml")):
        return make_engine(simulator, batch_size, device, parameters, **options)
    content = read_simulator(Path(simulator))
    merged = {**content["parameters"], **(parameters or {})}
    settings = {**content["options"], **options}
    engine = make_simulator(content["engine"], batch_size, device, merged or None, **settings)
    return with_effects(engine, effects_for(engine, content["effects"]))


def effects_for(engine: EnvBase, effects: Mapping[str, Mapping[str, Any] | None]) -> list[Effect]:
    """Effects of a simulator file, at the control period of the engine that they stand over.

    Args:
        engine: The simulator.
        effects: Name -> parameters and options, as for `make_effects`.
    """
    dt = getattr(engine, "dt", CONTROL_PERIOD)
    own = {} if dt == CONTROL_PERIOD else {"dt": dt}
    return make_effects({name: {**own, **(values or {})} for name, values in effects.items()})


def with_effects(engine: EnvBase, effects: Sequence[Transform]) -> EnvBase:
    """Appends effects to an engine, from the engine outwards; without any, returns the engine."""
    if not effects:
        return engine
    base, beneath = _parts(engine)
    env = StackedEnv(base, Compose([]))
    for effect in (*beneath, *effects):
        env.append_transform(effect)
    return env


def _parts(simulator: EnvBase) -> tuple[EnvBase, list[Transform]]:
    """The engine of a simulator, in single precision, and copies of the transforms over it."""
    if not isinstance(simulator, TransformedEnv):
        return in_single_precision(simulator), []
    stack = simulator.transform
    parts = stack if isinstance(stack, Compose) else [stack]
    return in_single_precision(simulator.base_env), [part.clone() for part in parts]


def make_env(
    engine: EnvBase | str | Path | Factory,
    effects: Sequence[Transform] = (),
    task: TaskConfig | None = None,
    batch_size: int | Sequence[int] = (),
    device: str = "cpu",
    paths: PathSet | None = None,
) -> TaskEnv:
    """Puts missing physics and a task over an engine.

    Args:
        engine: A simulator, or what `make_simulator` makes one of.
        effects: Missing physics, from the engine outwards.
        task: None is the default task.
        batch_size: Number of environments or a shape, for an engine that is still to be made.
        device: Likewise.
        paths: To follow instead of `task.paths`.

    Raises:
        ValueError: A transform is unknown, or stands where it cannot work; or a step of a simulator
            of one's own depends on more than its TensorDict.
    """
    task = scaled_task(task or TaskConfig())
    if not isinstance(engine, EnvBase):
        engine = make_simulator(engine, batch_size, device)
    elif not isinstance(getattr(engine, "base_env", engine), Engine):
        refuse_stateful(engine, type(engine).__name__)
    base, beneath = _parts(engine)
    env = TaskEnv(base, Compose([]))
    context = {
        "paths": make_paths(task.paths) if paths is None else paths,
        "dt": getattr(base, "dt", CONTROL_PERIOD),
        "rest": declared_by(base).rest,
    }
    stack = [
        make_transform(c.name, c.options, **context) for c in transforms_in_order(task.transforms)
    ]
    endings = [] if isinstance(base, Engine) else [Endings()]  # an engine itself ends nothing
    for transform in (*endings, *beneath, *effects):
        env.append_transform(transform)
    for index, transform in enumerate(stack):
        if isinstance(transform, TaskTransform):
            env.append_transform(transform)
        else:
            _append_foreign(env, transform, behind=stack[index + 1 :])
    _ = env.output_spec  # a transform of ours that stands in a wrong place says so here
    _refuse_lost_reward(env, stack)
    return env


def _append_foreign(env: TaskEnv, transform: Transform, behind: Sequence[Transform]) -> None:
    """Appends a transform that does not check its place itself, such as one of TorchRL's.

    Raises:
        ValueError: It reads a key that nothing before it writes, takes away one that the next step
            needs, or cannot be used as it is.
    """
    name, reads = type(transform).__name__, getattr(transform, "in_keys", None) or ()
    missing = sorted(str(key) for key in reads if key not in _written(env))
    if missing:
        raise ValueError(
            f"{name} reads {', '.join(missing)}, which nothing before it writes: put the "
            "transform that does before it in the stack, or name other in_keys"
        )
    if keys.REWARD in reads and any(isinstance(other, Rewards) for other in behind):
        raise ValueError(f"{name} comes too early: it reads reward, which Rewards writes behind it")
    state = set(env.full_state_spec.keys(True, True)) & _written(env)
    try:
        env.append_transform(transform)
        lost = sorted(map(str, state - _written(env)))
    except (KeyError, TypeError, RuntimeError, AttributeError) as error:
        raise ValueError(f"{name} cannot stand here: {one_line(error)}") from error
    if lost:
        raise ValueError(f"{name} takes away {', '.join(lost)}, which the next step needs")


def _refuse_lost_reward(env: TaskEnv, stack: Sequence[Transform]) -> None:
    """Tries each transform of a user's own that stands before `Rewards` in one step.

    Raises:
        ValueError: It writes the reward, which `Rewards` would replace.
    """
    place = next((i for i, other in enumerate(stack) if isinstance(other, Rewards)), 0)
    known = ("buggy_rl.", "torchrl.")  # ours leave it alone; TorchRL's say so by their in_keys
    own = [part for part in stack[:place] if not type(part).__module__.startswith(known)]
    for transform in own:
        state = env.fake_tensordict()
        after = state.pop("next")
        reward = after.get(keys.REWARD)
        version = reward._version
        with contextlib.suppress(Exception):  # what fails here fails in the first step, in full
            tried = transform.clone()
            tried._step(tried._inv_call(state), after)
        if after.get(keys.REWARD) is not reward or reward._version != version:
            raise ValueError(
                f"{type(transform).__name__} changes the reward before Rewards writes it: put it "
                "behind rewards"
            )


def _written(env: EnvBase) -> set[NestedKey]:
    """Keys, nested ones too, of what an environment gives out and takes in."""
    specs = (env.full_observation_spec, env.full_done_spec, env.full_reward_spec)
    return {key for spec in (*specs, env.full_action_spec) for key in spec.keys(True)}
