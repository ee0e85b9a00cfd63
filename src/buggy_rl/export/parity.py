"""The car's runtime against the task that a policy was trained on, step by step.

The TorchRL stack drives; the runtime is given the same poses and velocities and keeps filters,
waypoints and commands of its own. What both make of them is compared in every step.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, ClassVar

import torch
from tensordict import TensorDictBase
from torch import Tensor

from buggy_rl.car.path import Path as CarPath
from buggy_rl.car.policy import COMPLETED, LEFT
from buggy_rl.car.policy import Policy as Runtime
from buggy_rl.core import keys
from buggy_rl.core.stepping import trajectory
from buggy_rl.policies.evaluation.drives import evaluation_task
from buggy_rl.policies.training.actor_critic import Policy
from buggy_rl.task.config import TaskConfig, TransformConfig
from buggy_rl.task.env import TaskEnv
from buggy_rl.task.transforms.commands import CommandFilter
from buggy_rl.task.transforms.observation import ObservationNoise

ACTING = "acting_command"  # [2] what left the task for the simulator
SPREAD = (0.5, 0.5, 3.14)  # [m], [m], [rad] random poses about the next waypoint
FASTEST = (10.0, 5.0, 9.0)  # [m/s], [m/s], [rad/s] random velocities: beyond all clipping
SILENT = {"position": 0.0, "yaw": 0.0, "velocity": 0.0, "yaw_rate": 0.0}  # noise of none


class ParityError(ValueError):
    """The runtime does something else than the task of training."""


class ActingCommand(CommandFilter):
    """Records what the task hands to the simulator, u'_t = u_t within [-1, 1]."""

    memory: ClassVar[str] = ACTING

    def _filtered(self, previous: Tensor, asked: Tensor) -> Tensor:
        return asked


def parity_task(task: TaskConfig, steps: int) -> TaskConfig:
    """The task in evaluation, without noise, with `ActingCommand` next to the simulator."""
    places = dict(evaluation_task(task, steps).transforms)
    for place, config in places.items():
        if _is_noise(config.name):
            places[place] = replace(config, options=SILENT)
    acting = TransformConfig(f"{__name__}:{ActingCommand.__name__}")
    return replace(task, transforms={"acting": acting, **places})


def _is_noise(name: str) -> bool:
    return name == "observation_noise" or name.endswith(f"noise:{ObservationNoise.__name__}")


@dataclass
class Parity:
    """One drive of the stack with the runtime beside it.

    Args:
        runtime: As it will be on the car.
        policy: In training's form.
        env: Of one car, from `make_env` with `parity_task`.
        path: Of that car.
        where: What messages call the drive.
        tolerance: Largest difference.
    """

    runtime: Runtime
    policy: Policy
    env: TaskEnv
    path: CarPath
    where: str
    tolerance: float

    def __post_init__(self) -> None:
        self.largest = {"observation": 0.0, "command": 0.0}
        self.steps = 0

    def run(
        self, steps: int, scatter: Callable[[TensorDictBase], TensorDictBase] | None = None
    ) -> dict[str, float]:
        """Largest differences of an episode of at most `steps` steps, and its steps.

        Args:
            steps: At most; the end of the episode is the end unless poses are scattered.
            scatter: Edits the state that a step begins from.

        Raises:
            ParityError: A difference is above the tolerance; the message names the first.
        """
        for after in self._drive(steps, scatter):
            if scatter is None and bool(after[keys.DONE].any()):
                break
        return {**self.largest, "steps": self.steps}

    def _drive(self, steps: int, scatter: Any) -> Iterator[TensorDictBase]:
        driver, state = self.policy.driver(), self.env.reset()
        speed = state.get(keys.TARGET_SPEED, None)
        self.runtime.reset(self.path, None if speed is None else float(speed))
        given = (0.0, 0.0)

        def act(_: int, now: TensorDictBase) -> TensorDictBase:
            nonlocal given
            given = self._ask_runtime(now)
            asked = driver(now)
            return asked if scatter is None else scatter(asked)

        for _, after in pairwise(trajectory(self.env, state, act, steps)):
            for name, mine, theirs in zip(
                ("throttle", "steering"), given, _numbers(after, ACTING), strict=True
            ):
                self._compare("command", name, mine, theirs)
            self.steps += 1
            yield after

    def _ask_runtime(self, now: TensorDictBase) -> tuple[float, float]:
        """The runtime's command for a state, whose observation is compared."""
        vx, vy, yaw_rate = _numbers(now, keys.VELOCITY)
        given = self.runtime.step(_numbers(now, keys.POSE), (vx, vy, yaw_rate))
        following = int(now[keys.NEXT_WAYPOINT])
        self._compare("", "next_waypoint", self.runtime.waypoints.next, following)
        self._compare_end(now)
        shown = _numbers(now, keys.OBSERVATION)
        mine = self.runtime.observation.values.tolist()
        if len(mine) != len(shown):
            raise ParityError(
                f"{self.where}: the observation has {len(mine)} numbers in the runtime and "
                f"{len(shown)} in training"
            )
        for index, (here, there) in enumerate(zip(mine, shown, strict=True)):
            self._compare("observation", index, here, there)
        return given

    def _compare_end(self, now: TensorDictBase) -> None:
        left = bool(now[keys.TERMINATED])
        ended = LEFT if left else COMPLETED if bool(now[keys.COMPLETED]) else ""
        limit = self.runtime.settings["leave_path"]
        if self.runtime.ended != ended and (limit is not None or not left):
            raise ParityError(
                f"{self.where}, step {self.steps}: the drive is {self.runtime.ended or 'going on'} "
                f"in the runtime and {ended or 'going on'} in training"
            )

    def _compare(self, kind: str, name: int | str, mine: float, theirs: float) -> None:
        apart = abs(mine - theirs)
        if not apart <= self.tolerance:
            field = self._named(name) if isinstance(name, int) else name
            raise ParityError(
                f"{self.where}, step {self.steps}: {field} is {mine:.9g} in the runtime and "
                f"{theirs:.9g} in training, {apart:.2g} apart where {self.tolerance:g} is allowed"
            )
        if kind:
            self.largest[kind] = max(self.largest[kind], apart)

    def _named(self, index: int) -> str:
        row = self.runtime.settings["observation"]
        numbers = row["numbers"]
        back, column = divmod(index, len(numbers))
        past = row["rows"] - 1 - back
        return f"observation {numbers[column]['name']}" + (f" of {past} steps ago" if past else "")


def _numbers(state: TensorDictBase, key: str) -> list[float]:
    return state.get(key).flatten().tolist()


def scattered(path: CarPath, seed: int) -> Callable[[TensorDictBase], TensorDictBase]:
    """Edits a state: a random pose about the next waypoint, and a random velocity."""
    generator = torch.Generator().manual_seed(seed)
    points = torch.as_tensor(path.points)
    spread, fastest = torch.tensor(SPREAD), torch.tensor(FASTEST)

    def edit(state: TensorDictBase) -> TensorDictBase:
        drawn = 2 * torch.rand(2, 1, 3, generator=generator) - 1
        following = int(state[keys.NEXT_WAYPOINT]) % len(points)
        pose = drawn[0] * spread
        pose[:, :2] += points[following]
        return state.set(keys.POSE, pose).set(keys.VELOCITY, drawn[1] * fastest)

    return edit
