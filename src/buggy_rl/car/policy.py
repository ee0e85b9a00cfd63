"""A trained policy on the car: pose and velocity in, throttle and steering out, in numpy.

    policy = Policy.load("policy.json")
    policy.reset(load_path("lap.csv"))
    throttle, steering = policy.step((x, y, yaw), (vx, vy, yaw_rate))   # once a control period
    if policy.ended: ...

It holds all of the task that the network saw in training: filters of the velocity, waypoints, past
observations, filters of the command. `scripts/export_policy.py` has compared it with the task.
`make_path_driver` makes what drives where no person does: such a policy, or pure pursuit.
"""

import math
from typing import Any, Dict, Mapping, NamedTuple, Optional, Sequence

import numpy as np

from buggy_rl.car.commands import bounded, make_command_filter
from buggy_rl.car.interfaces import Command, Reading, neutral_of
from buggy_rl.car.observation import Observation, Velocity, make_sensing
from buggy_rl.car.path import Path, Pursuit, Waypoints, load_path
from buggy_rl.car.policy_file import Network, PolicyFile, read_policy
from buggy_rl.car.settings import section

LEFT = "left the path"
COMPLETED = "completed the path"
VELOCITIES = ("velocity", "measured_velocity")  # inputs that are the filtered velocity


class Policy:
    """The mean command of a trained policy, without exploration.

    Args:
        content: From `read_policy`.
    """

    def __init__(self, content: PolicyFile) -> None:
        about = content.settings
        self.settings = about
        self.two_way = bool(about.get("two_way", False))
        """Whether no drive is throttle 0, not -1."""
        at_rest = neutral_of(self.two_way)
        self.control_period: float = about["control_period"]
        self.ended = ""  # or why the task would have ended the episode
        self.lateral_error, self.heading_error = 0.0, 0.0  # [m], [rad]
        self.target_speed = 0.0  # [m/s]
        self.waypoints = Waypoints(**about["waypoints"])
        limit: Optional[float] = about["leave_path"]
        self._leave_path = math.inf if limit is None else limit  # [m]
        self._sensing = [make_sensing(entry) for entry in about["sensing"]]
        self._commands = [make_command_filter(entry, at_rest) for entry in about["commands"]]
        scaling = [content.arrays[name] for name in ("mean", "sd") if name in content.arrays]
        network = about["network"]
        self._network = Network(
            content.layers, network["activation"], scaling, network["observation_limit"]
        )
        row = about["observation"]
        self.observation = Observation(row["inputs"], row["rows"], self.waypoints.visible)
        self._memories = {part.key: part for part in self._commands}
        self._velocity: Velocity = (0.0, 0.0, 0.0)
        self._begun, self._has_path = False, False
        self._at_rest = at_rest
        self._given: Command = at_rest  # the command that was returned last

    @classmethod
    def load(cls, file: str) -> "Policy":
        """Reads an exported policy, named by either of its two files.

        Raises:
            ValueError: A file is missing or does not fit; the message names it.
        """
        return cls(read_policy(file))

    def reset(self, path: Path, target_speed: Optional[float] = None) -> None:
        """Begins a drive along a path, with all filters as at the start of an episode.

        Args:
            path: In the frame of the poses that `step` will be given.
            target_speed: [m/s] for a policy that was trained with one; the lowest by default.

        Raises:
            ValueError: The speed is out of the range of training, or the policy has none.
        """
        self.target_speed = self._speed(target_speed)
        self.waypoints.follow(path)
        for part in (*self._sensing, *self._commands, self.observation):
            part.reset()
        self.ended, self._begun, self._has_path = "", False, True
        self._given = self._at_rest

    def step(self, pose: Sequence[float], velocity: Velocity) -> Command:
        """The command for the control period that begins now.

        Args:
            pose: x, y [m], yaw [rad] in the frame of the path.
            velocity: vx, vy [m/s], yaw_rate [rad/s] in the body frame.

        Returns:
            Throttle and steering in [-1, 1].

        Raises:
            ValueError: `reset` was not called, or a number is not finite.
        """
        if not self._has_path:
            raise ValueError("policy.step before policy.reset: give it a path first")
        if not math.isfinite(sum(pose) + sum(velocity)):
            raise ValueError(f"policy: pose {pose} and velocity {velocity} must be finite")
        x, y, yaw = np.float32(pose[0]), np.float32(pose[1]), np.float32(pose[2])
        self._follow(x, y, yaw)
        for sense in self._sensing:
            velocity = sense.filtered(velocity)
        self._velocity = velocity
        self.observation.advance()
        self.waypoints.see(x, y, yaw, self.observation.waypoints)
        self.observation.write(self._value)
        mean = self._network(self.observation.values)
        command = bounded((float(mean[0]), float(mean[1])))
        for part in self._commands:
            command = part.filtered(command)
        self._given = command
        return command

    def acted(self, command: Command) -> None:
        """Says what the wheels got in this step, after limits and people.

        Where that is not what `step` returned, the filters of the command and the last command
        that is observed go on from it, as in training, where nothing stands behind them.
        """
        if command != self._given:
            for part in self._commands:
                part.now = command

    def _follow(self, x: np.float32, y: np.float32, yaw: np.float32) -> None:
        """Closes waypoints and says whether the path is left or completed."""
        if self._begun:
            self.waypoints.advance(x, y)
        self.lateral_error, self.heading_error = self.waypoints.errors(x, y, yaw)
        if self._begun and abs(self.lateral_error) > self._leave_path:
            self.ended = LEFT
        elif self._begun and self.waypoints.completed:
            self.ended = COMPLETED
        self._begun = True

    def _value(self, key: str) -> Sequence[float]:
        """What the observation shows under a key, beside the waypoints."""
        if key in self._memories:
            return self._memories[key].now
        return self._velocity if key in VELOCITIES else (getattr(self, key),)

    def _speed(self, asked: Optional[float]) -> float:
        trained: Optional[Dict[str, Any]] = self.settings["target_speed"]
        if trained is None:
            if asked is not None:
                raise ValueError(f"target_speed={asked:g} m/s: the policy was trained without one")
            return 0.0
        low, high = trained["low"], trained["high"]
        speed = low if asked is None else asked
        if not low <= speed <= high:
            raise ValueError(f"target_speed={speed:g} m/s: trained in [{low:g}, {high:g}]")
        return speed


class PlacedPath(NamedTuple):
    """The path, and how it lies."""

    path: str
    """A CSV of waypoints x, y [m]."""
    placed: bool = False
    """The path begins where the car is armed; false: it lies in the tracker's frame."""


class PathDriver:
    """A policy on a path, begun anew at each arming.

    Args:
        policy: With `control_period`, `reset(path)`, `step(pose, velocity)`, `acted(command)` and
            `ended`.
        course: Its path.
    """

    def __init__(self, policy: Any, course: PlacedPath) -> None:
        self.policy, self.course = policy, course
        self._path = load_path(course.path)
        self._begun = False

    def begin(self, reading: Reading) -> None:
        """Begins the path and the policy anew from a reading on."""
        self.policy.reset(self._path.placed(reading.pose) if self.course.placed else self._path)
        self._begun = True

    def step(self, reading: Reading) -> Command:
        """The command for a reading."""
        return self.policy.step(reading.pose, reading.velocity)

    def acted(self, command: Command) -> None:
        """Says what the wheels got where this driver was asked, after limits and people."""
        self.policy.acted(command)

    def refuse_other_than(self, period: float) -> None:
        """Checks the control period [s] of the loop.

        Raises:
            ValueError: The policy has another one.
        """
        own = self.policy.control_period
        if abs(period - own) > 1e-9:
            raise ValueError(
                f"car.period={period:g} s, but the policy was made for {own:g} s: make them equal"
            )

    @property
    def ended(self) -> str:
        """Why it drives no further; empty if it does."""
        return self.policy.ended if self._begun else ""


def make_path_driver(about: Mapping[str, Any], two_way: bool = False) -> Optional[PathDriver]:
    """The driver that the section `policy` of a config names.

    Args:
        about: `kind` is `exported` (with `file`), `pursuit` (with the settings of `PursuitConfig`)
            or `none`; the first two need `path` and take `placed`.
        two_way: Whether the car brakes and reverses: no drive is throttle 0, not -1.

    Raises:
        ValueError: A key or a file is missing or wrong, or the policy is of the other kind of car.
    """
    settings = dict(about)
    kind = settings.pop("kind", None)
    if kind == "none" and not settings:
        return None
    own = {name: settings.pop(name) for name in PlacedPath._fields if name in settings}
    course = section(PlacedPath, own, "policy")
    if kind == "exported" and set(settings) == {"file"}:
        policy = Policy.load(settings["file"])
        if policy.two_way != two_way:
            trained = "with" if policy.two_way else "without"
            raise ValueError(
                f"policy {settings['file']} was trained on a car {trained} reverse, but "
                f"car.two_way is {str(two_way).lower()}: make them equal"
            )
        return PathDriver(policy, course)
    if kind == "pursuit":
        return PathDriver(Pursuit.from_dict(settings, two_way), course)
    raise ValueError(
        f'policy={dict(about)!r}: must be {{"kind": "exported", "file": F, "path": P}}, '
        '{"kind": "pursuit", "path": P} or {"kind": "none"}'
    )
