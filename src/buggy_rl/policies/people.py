"""A person's drive in real time: commands, a simulator, and what happens each step."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Literal, Protocol

import torch
from omegaconf import MISSING
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Composite
from torchrl.envs import EnvBase

from buggy_rl.car.clock import Deadlines
from buggy_rl.car.human import check_human
from buggy_rl.car.interfaces import NEUTRAL, Command
from buggy_rl.core import keys
from buggy_rl.core.stepping import reset_at, trajectory
from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.policies.closed_loop import Driver
from buggy_rl.policies.evaluation.drives import (
    RANDOM_STEPS,
    STEPS,
    benchmark_paths,
    evaluation_task,
)
from buggy_rl.task.config import TaskConfig
from buggy_rl.task.env import make_env, make_simulator
from buggy_rl.task.paths.making import make_paths


@dataclass(frozen=True)
class HumanConfig:
    """How keys and sticks become commands."""

    silence: float = 0.08
    """Time without a message after which the command is neutral [s]; a step later it is applied."""
    top_throttle: float = 0.0
    """Throttle that the forward key goes to, in (-1, 1]; 0 is half of the drive."""
    throttle_rise: float = 1.0
    """Rate of the forward key [1/s]; from no drive to half takes 1 s."""
    throttle_fall: float = 4.0
    """Rate after the forward key was released [1/s]."""
    lock: float = 1.0
    """Steering that a steering key goes to, in (0, 1]."""
    steering_rise: float = 4.0
    """Rate of a steering key [1/s]."""
    steering_fall: float = 8.0
    """Rate back towards the middle [1/s]."""
    dead_zone: float = 0.08
    """Dead zone of a stick about its middle."""
    two_way: bool = False
    """Whether the car brakes and reverses: no drive is throttle 0, not -1."""

    def __post_init__(self) -> None:
        check_human(self)


class Input(Protocol):
    """What a loop asks once a step."""

    def command(self, dt: float) -> Command:
        """The command for the step that begins now and lasts `dt` [s]."""
        ...


CourseName = Literal["lap", "infinity", "random", "none"]
DriverName = Literal["keyboard", "gamepad", "joystick", "scripted"]
LIMITS = {"lap": STEPS, "infinity": STEPS, "random": RANDOM_STEPS, "none": 6000}  # steps


@dataclass(frozen=True)
class DriveConfig:
    """Who drives what, where and for how long."""

    output: str = MISSING
    """The recording, a new .csv; what it is of is written beside it, as .json."""
    simulator: str = "mujoco"
    """An engine's name, a .yaml, a learned .pt, or file.py:factory."""
    course: CourseName = "lap"
    """lap, infinity, random, or none for a floor without waypoints."""
    seconds: float = 0.0
    """Driving time at most [s]; 0 is the original study's length (10, random 5), none 60."""
    driver: DriverName = "keyboard"
    """keyboard or gamepad in the browser, joystick on this machine, or scripted (pure pursuit)."""
    countdown: float = 3.0
    """Time before the car may drive [s]; none for a scripted driver."""
    view: bool = True
    """Shows the drive in the browser; a keyboard or gamepad needs it."""
    camera: Literal["chase", "top"] = "chase"
    """Camera behind the car, or above it; C changes it."""
    port: int = 0
    """Port of the page with the keys, on 127.0.0.1; 0 takes a free one."""
    human: HumanConfig = field(default_factory=HumanConfig)
    task: TaskConfig = field(default_factory=TaskConfig)
    seed: int = 0
    """Seed of the simulator's noise, if it has any."""
    threads: int = 1
    """Threads of PyTorch."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.seconds) and self.seconds >= 0):
            raise ValueError(f"seconds={self.seconds:g}: must be 0 or above and finite")
        if not 0 <= self.countdown <= 60:
            raise ValueError(f"countdown={self.countdown:g} s: must be in [0, 60]")
        if self.driver == "scripted" and self.course == "none":
            raise ValueError("driver=scripted follows a path: name a course, as course=lap")
        if self.in_browser and not self.view:
            raise ValueError(f"driver={self.driver} is a page in the browser: leave view=true")

    @property
    def in_browser(self) -> bool:
        """The browser's page is what drives."""
        return self.driver in ("keyboard", "gamepad")

    @property
    def steps(self) -> int:
        """Steps of the longest drive."""
        return round(self.seconds / CONTROL_PERIOD) if self.seconds else LIMITS[self.course]


@dataclass(frozen=True)
class LiveStep:
    """One step: the motion before it, its command, and how far the car had come."""

    time: float
    """Time since the start [s]."""
    values: tuple[float, ...]
    """[8] pose, velocity, action, as a recording's columns."""
    waypoints: int = 0
    """Waypoints closed when the step was over."""
    following: int = 0
    """Index of the next waypoint before the step."""
    done: bool = False
    """The task ended the drive with this step: the car left the path, or completed it."""


class ScriptedInput:
    """Stands in for a person: a driver of the package, asked as a person would be.

    It is given what the car's state shows by `look` before each command.
    """

    def __init__(self, driver: Driver) -> None:
        self._driver = driver
        self._now = NEUTRAL

    def look(self, state: TensorDictBase) -> None:
        """Takes the state [1] that the next command is for."""
        action: torch.Tensor = self._driver(state.copy()).get(keys.ACTION)
        throttle, steering = action.flatten().tolist()
        self._now = throttle, steering

    def command(self, dt: float) -> Command:
        """The command for the step that begins now."""
        del dt
        return self._now


def drive_environment(config: DriveConfig) -> EnvBase:
    """The simulator, with the task of the course as in evaluation; without a course, alone."""
    simulator = make_simulator(config.simulator, 1)
    simulator.set_seed(config.seed)
    if config.course == "none":
        return simulator
    paths = benchmark_paths(config.task.paths, 1)[config.course].paths
    task = evaluation_task(config.task, config.steps)
    env = make_env(simulator, task=task, paths=make_paths(paths).select([0]))
    env.set_seed(config.seed)
    return env


def has_course(env: EnvBase) -> bool:
    """Whether there are waypoints to close."""
    observed = env.observation_spec
    return isinstance(observed, Composite) and keys.NEXT_WAYPOINT in observed


def start(env: EnvBase) -> TensorDictBase:
    """The car at rest where its path begins, or at the origin."""
    rest = torch.zeros(1, 3)
    if has_course(env):
        return env.reset()
    return reset_at(env, TensorDict({keys.POSE: rest, keys.VELOCITY: rest.clone()}, [1]))


def live_steps(
    env: EnvBase, state: TensorDictBase, source: Input, steps: int, deadlines: Deadlines
) -> Iterator[LiveStep]:
    """Drives in real time until the task ends it or the steps are over; yields each step.

    Args:
        env: From `drive_environment`.
        state: From `start`.
        source: Asked for a command when its step is due.
        steps: At most.
        deadlines: Of the steps.

    Raises:
        FloatingPointError: The simulator diverged.
    """
    dt, waypoints = deadlines.dt, 0

    def act(_: int, now: TensorDictBase) -> TensorDictBase:
        if isinstance(source, ScriptedInput):
            source.look(now)
        deadlines.wait()
        return now.set(keys.ACTION, torch.tensor([source.command(dt)], dtype=torch.float32))

    for step, (before, after) in enumerate(pairwise(trajectory(env, state, act, steps))):
        values = _values(before)
        if not all(map(math.isfinite, values)):
            raise FloatingPointError(f"the simulator diverged after {step * dt:.2f} s of driving")
        following = _number(before, keys.NEXT_WAYPOINT)
        waypoints += _number(after, keys.WAYPOINTS_CLOSED)
        done = bool(after[keys.DONE].any())
        yield LiveStep(step * dt, values, waypoints, following, done)
        if done:
            return


def _values(state: TensorDictBase) -> tuple[float, ...]:
    parts = [state.get(key).flatten() for key in (keys.POSE, keys.VELOCITY, keys.ACTION)]
    return tuple(torch.cat(parts).tolist())


def _number(state: TensorDictBase, key: str) -> int:
    value = state.get(key, None)
    return 0 if value is None else int(value)
