"""What a user names on a command line, driven or replayed -> the tracks of a film."""

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise, zip_longest
from pathlib import Path
from typing import cast

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from buggy_rl.core import keys
from buggy_rl.core.car_file import load_car
from buggy_rl.core.stepping import reset_at, trajectory
from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.policies.closed_loop import Driver
from buggy_rl.policies.controllers.at_scale import for_car
from buggy_rl.policies.controllers.path_tracking import PurePursuit, Stanley
from buggy_rl.policies.evaluation.drives import Benchmark, benchmark_paths, evaluation_task
from buggy_rl.policies.training.actor_critic import load_policy
from buggy_rl.policies.training.run import EngineConfig, new_engine, task_of, training_engine
from buggy_rl.recordings import Recording, load_recording
from buggy_rl.recordings.readers import is_recording
from buggy_rl.simulators import ENGINES
from buggy_rl.task.config import TaskConfig
from buggy_rl.task.env import make_env, make_simulator
from buggy_rl.task.paths.making import PathConfig, make_paths
from buggy_rl.task.transforms.waypoints import Waypoints
from buggy_rl.visual.film.options import RenderConfig
from buggy_rl.visual.film.track import PathLine, Track, from_recording, from_rollout, recording_rows

WARM_UP = (
    30  # rows (0.3 s) of imposed motion before a start, for latent states that no one measured
)


def replayed(
    make: Callable[[int], EnvBase],
    recording: Recording,
    name: str,
    start: float = 0.0,
    seconds: float = float("inf"),
    restart: float = 0.0,
) -> Track:
    """What a simulator makes of a recording's commands, from its measured pose and velocity.

    Args:
        make: Builds the simulator for a number of environments.
        recording: Commands, starts and length.
        name: In the legend.
        start: [s] of the recording.
        seconds: Length at most [s].
        restart: [s] after which it starts again from what was measured; 0 for never.

    Raises:
        ValueError: `start` is outside the recording or in a gap, or the simulator diverges.
    """
    rows = recording_rows(recording, start, seconds)
    count = rows.stop - rows.start
    horizon = min(count, max(1, round(restart / recording.dt)) if restart else count)
    begins = torch.arange(rows.start, rows.stop, horizon)  # (N,)
    # Row k of environment i is row begins[i] - WARM_UP + k of the recording, held at its ends.
    index = begins[:, None] + torch.arange(-WARM_UP, horizon)
    index = index.clamp(_segment_start(recording, rows.start), rows.stop - 1)  # (N, L)
    pose, velocity, action = (
        recording.data[key][index] for key in (keys.POSE, keys.VELOCITY, keys.ACTION)
    )

    def act(row: int, state: TensorDictBase) -> TensorDictBase:
        if row <= WARM_UP:
            state[keys.POSE] = pose[:, row].to(state[keys.POSE])
            state[keys.VELOCITY] = velocity[:, row].to(state[keys.VELOCITY])
        return state.set(keys.ACTION, action[:, row])

    env = make(len(begins))
    begin = TensorDict({keys.POSE: pose[:, 0], keys.VELOCITY: velocity[:, 0]}, [len(begins)])
    states = trajectory(env, reset_at(env, begin), act, index.shape[1])
    driven = _stacked(states)[:, WARM_UP:]  # (N, horizon)
    flat = cast(TensorDict, cast(TensorDict, driven).reshape(-1)[:count])
    again = recording.dt * torch.arange(horizon, count, horizon).double().numpy()
    return replace(from_rollout(flat, name, recording.dt), restarts=again)


def driven_track(env: EnvBase, driver: Driver, steps: int, name: str, seed: int = 0) -> Track:
    """What a driver makes of the first path of a task, to the end of its episode.

    Args:
        env: From `make_env`, with a batch of one car.
        driver: A policy's `driver()`, or one of `buggy_rl.policies.controllers`.
        steps: Longest episode.
        name: In the legend.
        seed: Of the start and of noise.
    """
    kept = []
    with torch.random.fork_rng():
        torch.manual_seed(seed)  # of what has no generator of its own
        env.set_seed(seed)
        states = trajectory(env, env.reset(), lambda _, now: driver(now), steps)
        for state, following in pairwise(states):
            kept.append(_shown(state))
            if bool(following[keys.DONE].any()):
                break
    rows = cast(TensorDict, cast(TensorDict, TensorDict.stack(kept, 1))[0])
    return from_rollout(rows, name, getattr(env, "dt", CONTROL_PERIOD), course_of(env))


def course_of(env: EnvBase, index: int = 0) -> PathLine | None:
    """The path of an environment's transforms; None where there is no path."""
    transform = getattr(env, "transform", None)
    for part in transform if transform is not None else ():
        if isinstance(part, Waypoints):
            paths = part.paths
            points = paths.points[index, : int(paths.count[index])].double().numpy()
            return PathLine(points, bool(paths.closed[index]))
    return None


def _stacked(states) -> TensorDictBase:
    """States with their actions [N, T]; the last one, which has none, is left out."""
    kept = [_shown(state) for state, _ in pairwise(states)]
    return cast(TensorDict, TensorDict.stack(kept, 1))


def _shown(state: TensorDictBase) -> TensorDictBase:
    """What a track needs of a state."""
    wanted = (keys.POSE, keys.VELOCITY, keys.ACTION, keys.NEXT_WAYPOINT)
    return state.select(*wanted, strict=False).clone()


def _segment_start(recording: Recording, row: int) -> int:
    """First row of the segment that a row is in."""
    segment: Tensor = recording.data[keys.SEGMENT].flatten()
    return int((segment == segment[row]).nonzero()[0])


CONTROLLERS = {"pure_pursuit": PurePursuit, "stanley": Stanley}


@dataclass(frozen=True)
class RenderSource:
    """Loads what a config names, each file once."""

    config: RenderConfig

    def tracks(self) -> list[Track]:
        """The car's track, then the ghosts'.

        Raises:
            ValueError: A name is nothing that can be filmed, or does not go with the others.
        """
        names = self.config.trajectories
        kinds = {kind_of(name) for name in names}
        if self._recording and "driver" in kinds:
            raise ValueError(
                f"{' and '.join(names)}: a driver follows a course and no recorded commands; "
                "compare a recording with a simulator, or a driver with a driver"
            )
        tracks = [self._track(name) for name in names]
        if self.config.car:
            length = load_car(self.config.car).similarity.length
            tracks = [track.drawn_at(length) for track in tracks]
        return [
            replace(track, name=name) if name else track
            for track, name in zip_longest(tracks, self.config.names)
        ]

    def _track(self, name: str) -> Track:
        kind, config = kind_of(name), self.config
        if kind == "recording":
            return from_recording(self._load(name), config.start, config.seconds)
        if kind == "simulator" and self._recording:
            return replayed(
                partial(make_simulator, name, **self._engine(name).options),
                self._load(self._recording),
                label(name),
                config.start,
                config.seconds,
                config.restart,
            )
        return self._drive(name)

    def _drive(self, name: str) -> Track:
        """A driver on a course; a simulator without commands is driven by pure pursuit."""
        driver, engine, task = self._driver(name)
        if kind_of(name) == "driver" and self.config.simulator:
            engine = self._engine(self.config.simulator)
        steps = max(2, round(self.config.seconds / CONTROL_PERIOD))
        paths = make_paths(self._benchmark(task).paths).select([0])
        env = make_env(new_engine(engine, 1), task=evaluation_task(task, steps), paths=paths)
        return driven_track(env, driver, steps, label(name), self.config.seed)

    def _driver(self, name: str) -> tuple[Driver, EngineConfig, TaskConfig]:
        """Who drives, and the simulator and task that go with it."""
        if kind_of(name) == "simulator":
            return self._controller("pure_pursuit"), self._engine(name), self._task
        if name not in CONTROLLERS:
            policy, about = load_policy(name)
            return policy.driver(), training_engine(about, name), task_of(about, name)
        # Beside a policy or a simulator it drives the same car on the same path.
        others = [other for other in self.config.trajectories if other not in CONTROLLERS]
        if others:
            _, engine, task = self._driver(others[0])
            return self._controller(name), engine, task
        return self._controller(name), self._engine("mujoco"), self._task

    def _controller(self, name: str) -> Driver:
        return for_car(lambda command: CONTROLLERS[name](command=command), self.config.car)

    @property
    def _task(self) -> TaskConfig:
        return TaskConfig(paths=PathConfig(car=self.config.car))

    def _engine(self, simulator: str) -> EngineConfig:
        """A simulator, as the car if it is one of ours by name; a file says itself what it is."""
        known = self.config.car and simulator in ENGINES
        return EngineConfig(simulator, options={"car": self.config.car} if known else {})

    def _benchmark(self, task: TaskConfig) -> Benchmark:
        known = benchmark_paths(task.paths, 1)
        course = self.config.course
        if course in known:
            return known[course]
        if not course.endswith(".csv"):
            raise ValueError(f"course={course!r}: must be one of {', '.join(known)}, or a .csv")
        return Benchmark(PathConfig(kind="file", file=course), 0)

    @cached_property
    def _recording(self) -> str:
        """The recording whose commands simulators are given; empty if none is named."""
        named = (self.config.recording, *self.config.trajectories)
        return next((name for name in named if name and kind_of(name) == "recording"), "")

    def _load(self, name: str) -> Recording:
        return load_recording(name, self.config.columns or None, car=self.config.car)


def kind_of(name: str) -> str:
    """`recording`, `driver` or `simulator`.

    Raises:
        ValueError: A file does not exist, or is none of these.
    """
    path = Path(name)
    if name in CONTROLLERS:
        return "driver"
    if path.exists() and is_recording(path):
        return "recording"
    file = re.search(r"\.(csv|parquet|bag|pt|ya?ml)$", name)
    if file and not path.exists():
        raise ValueError(f"there is no file {name}: correct the path")
    if path.suffix != ".pt":
        return "simulator"
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:
        raise ValueError(f"{name} is not a file of PyTorch: {error}") from error
    return "driver" if isinstance(content, dict) and "policy" in content else "simulator"


def label(name: str) -> str:
    """What the legend calls it: the file's name, with its folder where that alone says nothing."""
    path = Path(name)
    if path.suffix not in (".yaml", ".yml", ".pt"):
        return name.rpartition("/")[2]
    common = {"best", "last", "model", "repaired", "mujoco_fitted"}
    return f"{path.parent.name}/{path.stem}" if path.stem in common - {"repaired"} else path.stem
