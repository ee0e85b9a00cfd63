"""What a user names on a command line -> the tracks of a film."""

import re
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import zip_longest
from pathlib import Path

import torch

from buggy_rl.car_file import load_car
from buggy_rl.engines import ENGINES
from buggy_rl.policies.actor_critic import load_policy
from buggy_rl.policies.benchmark_paths import Benchmark, benchmark_paths, evaluation_task
from buggy_rl.policies.closed_loop import Driver
from buggy_rl.policies.controllers.at_scale import for_car
from buggy_rl.policies.controllers.pure_pursuit import PurePursuit
from buggy_rl.policies.controllers.stanley import Stanley
from buggy_rl.policies.run import EngineConfig, engine_of, new_engine, task_of
from buggy_rl.recordings import Recording, load_recording
from buggy_rl.recordings.readers import is_recording
from buggy_rl.task.config import TaskConfig
from buggy_rl.task.env import make_env, make_simulator
from buggy_rl.task.paths.making import PathConfig, make_paths
from buggy_rl.vehicle import CONTROL_PERIOD
from buggy_rl.viz.film.options import RenderConfig
from buggy_rl.viz.film.rollout import driven, replayed
from buggy_rl.viz.film.track import Track, from_recording

CONTROLLERS = {"pure_pursuit": PurePursuit, "stanley": Stanley}


@dataclass(frozen=True)
class Source:
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
        return driven(env, driver, steps, label(name), self.config.seed)

    def _driver(self, name: str) -> tuple[Driver, EngineConfig, TaskConfig]:
        """Who drives, and the simulator and task that go with it."""
        if kind_of(name) == "simulator":
            return self._controller("pure_pursuit"), self._engine(name), self._task
        if name not in CONTROLLERS:
            policy, about = load_policy(name)
            return policy.driver(), engine_of(about, name), task_of(about, name)
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
