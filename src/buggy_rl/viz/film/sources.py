"""Where tracks come from: a recording, a simulator that is driven, a policy."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import EnvBase

from buggy_rl import keys
from buggy_rl.config import from_plain
from buggy_rl.policies.actor_critic import load_policy
from buggy_rl.policies.benchmark_paths import benchmark_paths, evaluation_task
from buggy_rl.policies.closed_loop import Driver
from buggy_rl.policies.controllers.pure_pursuit import PurePursuit
from buggy_rl.policies.run import EngineConfig, new_engine
from buggy_rl.recordings import Recording, load_recordings
from buggy_rl.stepping import trajectory
from buggy_rl.task.env import TaskConfig, make_env, make_simulator
from buggy_rl.task.paths.making import make_paths
from buggy_rl.vehicle import CONTROL_PERIOD
from buggy_rl.viz.film.track import Track

TABLES = (".csv", ".parquet", ".npy", ".db3", ".mcap", ".bag")
COURSES = ("lap", "infinity", "random", "training", "validation")
Step = Callable[[], object]


@dataclass(frozen=True)
class Part:
    """What part of a drive is shown, and what is driven where nothing was recorded."""

    recording: Recording | None = None
    """Its commands drive a simulator from where it was."""
    start: float = 0.0
    """[s] since the recording began."""
    seconds: float = 10.0
    """Longest time."""
    course: str = "lap"
    """Path that is driven without a recording."""
    simulator: str = ""
    """What policies drive, where it is not what they were trained in."""
    seed: int = 0
    """Of whatever is random."""

    @property
    def steps(self) -> int:
        """Longest."""
        return max(1, round(self.seconds / CONTROL_PERIOD))


def is_recording(what: str) -> bool:
    """Whether it names recordings: a table, a bag, or a folder."""
    return what.lower().endswith(TABLES) or Path(what).is_dir()


def read_recording(what: str, columns: str = "") -> Recording:
    """The first recording of a file or folder.

    Raises:
        ValueError: There is none, or it was refused.
    """
    recordings, refusals = load_recordings([what], columns or None)
    if not recordings:
        why = "; ".join(map(str, refusals)) or "there is no recording in it"
        raise ValueError(f"{what}: {why}")
    return recordings[0]


def track_of(what: str, part: Part, step: Step = lambda: None) -> Track:
    """The track of a recording, a simulator or a policy.

    Args:
        what: A recording; an engine's name, .yaml, .pt or file.py:factory; or a policy's .pt.
        part: Which part, and what is driven.
        step: Called at every step that is simulated.

    Raises:
        ValueError: It is none of these, or the part is empty.
    """
    if is_recording(what):
        return of_recording(read_recording(what), part)
    if what.endswith(".pt") and _is_policy(what):
        return of_policy(what, part, step)
    if part.recording is not None:
        with torch.random.fork_rng():
            torch.manual_seed(part.seed)
            return of_simulator(make_simulator(what, 1), _name(what), part, step)
    return _of_driver(make_simulator(what, 1), TaskConfig(), PurePursuit(), _name(what), part, step)


def of_recording(recording: Recording, part: Part) -> Track:
    """The part of a recording as it was measured."""
    return Track(recording.name, *_columns(_rows(recording, part)))


def of_simulator(simulator: EnvBase, name: str, part: Part, step: Step = lambda: None) -> Track:
    """A simulator [1] under a recording's commands, from where the recording was.

    It shows what its sensor would show.
    """
    assert part.recording is not None
    data = _rows(part.recording, part)
    action = data[keys.ACTION]
    start = TensorDict({k: data[k][:1].clone() for k in (keys.POSE, keys.VELOCITY)}, [1])

    def act(row: int, state: TensorDictBase) -> TensorDictBase:
        step()
        return state.set(keys.ACTION, action[row : row + 1].to(state[keys.POSE].dtype))

    states = trajectory(simulator, simulator.reset(start), act, len(action) - 1)
    pose, velocity = _unwrapped([_seen(state) for state in states])
    time, _, _, commands = _columns(data)
    return Track(name, time, pose, velocity, commands)


def of_policy(file: str, part: Part, step: Step = lambda: None) -> Track:
    """A policy on its task, in the simulator it was trained in or in the part's."""
    policy, about = load_policy(file)
    engine = from_plain(EngineConfig, about["config"]["engine"], file)
    if part.simulator:
        engine = EngineConfig(part.simulator)
    task = from_plain(TaskConfig, about["config"]["task"], file)
    return _of_driver(new_engine(engine, 1), task, policy.driver(), _name(file), part, step)


def _of_driver(
    simulator: EnvBase, task: TaskConfig, driver: Driver, name: str, part: Part, step: Step
) -> Track:
    """A driver on the part's course, until the course or the time ends."""
    if part.course not in COURSES:
        raise ValueError(f"course={part.course}: must be one of {', '.join(COURSES)}")
    course = benchmark_paths(task.paths, 10)[part.course]
    paths = make_paths(course.paths)
    task = replace(evaluation_task(task, part.steps), paths=course.paths)
    env = make_env(simulator, task=task, paths=paths)
    env.set_seed(part.seed)
    rows: list[tuple] = []
    closed = torch.zeros(1)

    def act(_: int, state: TensorDictBase) -> TensorDictBase:
        step()
        return driver(state)

    with torch.random.fork_rng():
        torch.manual_seed(part.seed)
        states = trajectory(env, env.reset(), act, part.steps)
        for state, after in pairwise(states):
            rows.append((*_seen(state), state[keys.ACTION].clone(), closed.clone()))
            closed += after[keys.WAYPOINTS_CLOSED].reshape(1)
            if bool(after[keys.DONE]):
                break
    pose, velocity = _unwrapped([row[:2] for row in rows])
    action, done = (torch.cat([row[i] for row in rows]).double().numpy() for i in (2, 3))
    ahead = int(done[-1]) + paths.points.shape[1] if bool(paths.closed[0]) else 0
    time = CONTROL_PERIOD * torch.arange(len(rows)).double().numpy()
    waypoints = paths.extended(ahead)[0].double().numpy()
    if not ahead:
        waypoints = waypoints[: int(paths.count[0])]
    return Track(name, time, pose, velocity, action, waypoints, done)


def _rows(recording: Recording, part: Part) -> TensorDictBase:
    """The part of a recording that begins at its start, up to the next gap."""
    time = recording.data[keys.TIME][:, 0]
    first = int(((time - time[0]) < part.start - 1e-6).sum())
    if first >= len(time) - 1:
        raise ValueError(
            f"start={part.start:g}: {recording.name} has {float(time[-1] - time[0]):.1f} s only"
        )
    segment = recording.data[keys.SEGMENT]
    last = int((segment == segment[first]).nonzero().max()) + 1
    return recording.data[first : min(last, first + part.steps + 1)]


def _columns(data: TensorDictBase) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Time [T], pose, velocity and action."""
    rows: list[torch.Tensor] = [
        data.get(key) for key in (keys.TIME, keys.POSE, keys.VELOCITY, keys.ACTION)
    ]
    time, pose, velocity, action = (row.double().numpy() for row in rows)
    return time[:, 0], pose, velocity, action


def _seen(state: TensorDictBase) -> tuple[torch.Tensor, torch.Tensor]:
    """Pose and velocity [1, 3] as a sensor shows them, in a simulator that has one."""
    pose, velocity = state.get(keys.MEASURED_POSE, None), state.get(keys.MEASURED_VELOCITY, None)
    pose = state[keys.POSE] if pose is None else pose
    velocity = state[keys.VELOCITY] if velocity is None else velocity
    return pose.detach().clone(), velocity.detach().clone()


def _unwrapped(seen: Sequence[tuple[torch.Tensor, ...]]) -> tuple[NDArray, NDArray]:
    """Poses [T, 3], yaw unwrapped, and velocities [T, 3] of one car."""
    pose = torch.cat([p for p, _ in seen]).double().numpy()
    pose[:, 2] = np.unwrap(pose[:, 2])
    return pose, torch.cat([v for _, v in seen]).double().numpy()


def _is_policy(file: str) -> bool:
    if not Path(file).is_file():
        raise ValueError(f"there is no file {file}")
    content = torch.load(file, map_location="cpu", weights_only=True)
    return isinstance(content, dict) and {"policy", "about"} <= set(content)


def _name(what: str) -> str:
    """As a film calls a simulator or a policy."""
    file, _, factory = what.partition(":")
    return factory or Path(file).stem
