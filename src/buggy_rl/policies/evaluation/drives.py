"""The benchmark paths, and drives of policies round them beside pure pursuit."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from buggy_rl.core import keys
from buggy_rl.core.config import build
from buggy_rl.policies.closed_loop import Driver
from buggy_rl.policies.controllers.at_scale import taken_by
from buggy_rl.policies.controllers.path_tracking import PurePursuit, PurePursuitConfig
from buggy_rl.policies.training.actor_critic import load_policy
from buggy_rl.policies.training.run import EngineConfig, new_engine, task_of, training_engine
from buggy_rl.task.config import TaskConfig, TransformConfig, evaluation_transforms
from buggy_rl.task.env import make_env
from buggy_rl.task.paths.making import PathConfig, make_paths
from buggy_rl.task.paths.path_set import joined_paths

STEPS = 1000  # of an episode in the original study, 10 s
RANDOM_STEPS = 500  # on its third room path


@dataclass(frozen=True)
class Benchmark:
    """A set of paths and the steps of an episode on them."""

    paths: PathConfig
    steps: int


def benchmark_paths(paths: PathConfig, random_paths: int) -> dict[str, Benchmark]:
    """The original study's path sets: random ones, lap, infinity and the tight random path.

    Of the training paths they have the first `random_paths`.
    """
    plain = replace(paths, placed=False, mirrored=False, count=random_paths)
    return {
        "training": Benchmark(replace(plain, kind="simplex", part="training"), STEPS),
        "validation": Benchmark(replace(plain, kind="simplex", part="validation"), STEPS),
        "lap": Benchmark(replace(plain, kind="lap"), STEPS),
        "infinity": Benchmark(replace(plain, kind="infinity"), STEPS),
        "random": Benchmark(replace(plain, kind="tight"), RANDOM_STEPS),
    }


def evaluation_task(task: TaskConfig, steps: int, camera: bool = False) -> TaskConfig:
    """A task as policies are evaluated on it: one path each, from its start, for `steps` steps.

    `camera` adds the tracking camera's noise, as on the car.
    """
    stack = evaluation_transforms(task.transforms)
    stack["step_limit"] = TransformConfig("step_limit", {"max_steps": steps})
    if camera:
        stack["noise"] = TransformConfig("observation_noise")
    return replace(task, transforms=stack)


ROOM = ("lap", "infinity", "random")


@dataclass(frozen=True)
class ShowPoliciesConfig:
    """Policies, and the paths and cars that they are shown on."""

    output: str = "runs/policies.png"
    """The picture: .png, .svg or .pdf."""
    policies: dict[str, str] = field(default_factory=dict)
    """Policy files, as policies.NAME=FILE."""
    simulator: str = ""
    """Drives all policies beside the car; empty for the simulator that each was trained in."""
    car: str = "reference"
    """What stands for the real car; empty for none."""
    courses: list[str] = field(default_factory=lambda: list(ROOM))
    """Paths, a row each: any of lap, infinity, random."""
    pure_pursuit: str = ""
    """Numbers of the pure pursuit drawn beside them, a YAML of scripts/tune_drivers.py."""
    threads: int = 1
    """Threads of PyTorch."""


@dataclass(frozen=True)
class DrivenTrack:
    """One drive, to its end."""

    pose: Tensor
    """[T + 1, 3] where the car was."""
    velocity: Tensor
    """[T + 1, 3]"""
    waypoints: float
    """Waypoints closed."""
    lateral_mean: float
    """Mean distance from the path [m]."""


@dataclass(frozen=True)
class Panel:
    """A policy on a path, in its simulator or on the car."""

    policy: str
    place: str
    course: str
    waypoints: Tensor
    """[W, 2] of the path; a closed one ends where it begins."""
    track: DrivenTrack
    compared: DrivenTrack
    """Drive of pure pursuit on the same path."""


def policy_panels(
    config: ShowPoliciesConfig, progress: Callable[[Sequence], Iterable] = list
) -> Iterator[Panel]:
    """Drives every policy and pure pursuit in its simulator and on the car, path by path.

    Raises:
        ValueError: There is no policy, an unknown course, or a file cannot be read.
    """
    unknown = sorted(set(config.courses) - set(ROOM))
    if unknown or not config.courses:
        raise ValueError(f"courses={config.courses}: name some of {', '.join(ROOM)}")
    if not config.policies:
        raise ValueError("no policy to show: name some, as policies.NAME=FILE")
    numbers = [config.pure_pursuit] if config.pure_pursuit else []
    config_of_pursuit = build(PurePursuitConfig, numbers)
    places = ("simulator", "car") if config.car else ("simulator",)
    found = [(name, place) for name in config.policies for place in places]
    for name, place in progress(found):
        policy, about = load_policy(config.policies[name])
        engine = training_engine(about, config.policies[name])
        where = "in its simulator"
        if config.simulator:
            engine, where = EngineConfig(config.simulator), f"in {Path(config.simulator).name}"
        if place == "car":
            engine, where = EngineConfig(config.car), f"on the {car_name(config.car)}"
        task = task_of(about, config.policies[name])
        cars = new_engine(engine, 2 * len(config.courses))
        pursuit = PurePursuit(config_of_pursuit, taken_by(cars))
        driver = _side_by_side(policy.driver(), pursuit)
        for drives in _driven(cars, task, driver, config.courses, place == "car"):
            yield Panel(name, where, *drives)


def car_name(car: str) -> str:
    """What a picture or table calls that which stands for the real car."""
    return "reference car" if car == "reference" else Path(car).name


def _driven(
    cars: EnvBase, task: TaskConfig, driver: Driver, names: Sequence[str], camera: bool
) -> Iterator[tuple[str, Tensor, DrivenTrack, DrivenTrack]]:
    """Each course, its waypoints, and the drives of both halves of the cars; all at once."""
    known = benchmark_paths(task.paths, 1)
    steps = [known[name].steps for name in names]
    paths = joined_paths([make_paths(known[name].paths) for name in names])
    task = evaluation_task(task, max(steps), camera)
    env = make_env(cars, task=task, paths=joined_paths([paths, paths]))
    driven = tracks(env, driver, steps * 2)
    for index, name in enumerate(names):
        count = int(paths.count[index]) + int(paths.closed[index])
        yield name, paths.extended(1)[index, :count], driven[index], driven[index + len(paths)]


def _side_by_side(one: Driver, other: Driver) -> Driver:
    """The first half of the cars is driven by one, the second by the other."""

    def both(state: TensorDictBase) -> TensorDictBase:
        half = state.batch_size[0] // 2
        first, second = one(state.copy())[keys.ACTION], other(state.copy())[keys.ACTION]
        return state.set(keys.ACTION, torch.cat([first[:half], second[half:]]))

    return both


@torch.no_grad()
def tracks(env: EnvBase, driver: Driver, steps: Sequence[int]) -> list[DrivenTrack]:
    """Lets each of N cars drive one episode, for its own `steps` [N] at most."""

    def policy(tensordict: TensorDictBase) -> TensorDictBase:  # by its types TorchRL knows it
        return driver(tensordict)

    with torch.random.fork_rng():
        torch.manual_seed(0)  # of the camera's noise
        rows = env.rollout(max(steps), policy, break_when_any_done=False)  # [N, T]
    return [_track(car, limit) for car, limit in zip(rows, steps, strict=True)]


def _track(rows: TensorDictBase, limit: int) -> DrivenTrack:
    after: TensorDictBase = rows.get("next")
    done: Tensor = after.get(keys.DONE).flatten()
    ended = int(done.int().argmax()) + 1 if done.any() else len(done)
    until = min(ended, limit)

    def whole(key: str) -> Tensor:
        return torch.cat([rows.get(key)[:until], after.get(key)[until - 1 : until]])

    closed: Tensor = after.get(keys.WAYPOINTS_CLOSED)[:until]
    lateral: Tensor = after.get(keys.LATERAL_ERROR)[:until]
    mean = lateral.abs().mean().item()
    return DrivenTrack(whole(keys.POSE), whole(keys.VELOCITY), closed.sum().item(), mean)
