"""The simulator, its camera and its board, one control period at a time."""

import math
import threading
from collections import deque
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor

from buggy_rl.car.clock import Clock
from buggy_rl.car.interfaces import NEUTRAL, Command, neutral_of
from buggy_rl.core import keys
from buggy_rl.core.longitudinal import declared_by
from buggy_rl.core.stepping import reset_at
from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.recordings.camera import Camera, CameraConfig
from buggy_rl.simulated_car.config import SimulatedCarConfig
from buggy_rl.task.env import make_simulator

Triple = tuple[float, float, float]


class LiveCamera:
    """Measures motion as it happens; keeps only as many rows as its latency needs.

    Args:
        config: Errors of the camera, without a lag.
        seed: Of its noise.
    """

    def __init__(self, config: CameraConfig, seed: int) -> None:
        self._camera = Camera(config, seed)
        rows = 2 + math.ceil(config.latency / CONTROL_PERIOD)
        self._rows: deque[tuple[Tensor, Tensor]] = deque(maxlen=rows)

    def see(self, pose: Tensor, velocity: Tensor) -> tuple[Triple, Triple] | None:
        """Pose and velocity as measured of the true ones [3], or None for a dropped frame."""
        self._rows.append((pose, velocity))
        poses, velocities = (torch.stack(rows) for rows in zip(*self._rows, strict=True))
        measured = self._camera.measure(poses, velocities, CONTROL_PERIOD)
        x, y, yaw = measured[0][-1].tolist()
        vx, vy, yaw_rate = measured[1][-1].tolist()
        dropped = not self._camera.arrived(2)[1]
        return None if dropped else ((x, y, yaw), (vx, vy, yaw_rate))


WARM_UP = 3  # steps before the clock starts: the first ones of PyTorch take longer


class Physics:
    """A car that starts at rest.

    Args:
        config: The car.

    Raises:
        ValueError: The simulator is unknown, or cannot have the faults.
        FloatingPointError: From `step`, when the simulator diverges.
    """

    def __init__(self, config: SimulatedCarConfig) -> None:
        options: dict[str, Any] = dict(config.options)
        if config.faults:
            options["faults"] = config.faults
        if config.compiled:
            options["compiled"] = True
        self._env = make_simulator(config.simulator, 1, **options)
        command = declared_by(self._env)
        if command.two_way != config.two_way:
            raise ValueError(
                f"simulator {config.simulator} takes the command {command}, which is at rest at "
                f"{command.rest:g}; the car's runtime stops by {neutral_of(config.two_way)[0]:g}: "
                f"set two_way={str(command.two_way).lower()}"
            )
        self._env.set_seed(config.seed)
        self._camera = LiveCamera(config.camera, config.seed)
        pose = torch.tensor([[config.x, config.y, config.yaw]])
        start = TensorDict({keys.POSE: pose, keys.VELOCITY: torch.zeros(1, 3)}, [1])
        for _ in range(WARM_UP):
            self._state = reset_at(self._env, start.clone())
            self.step(neutral_of(config.two_way))
        self._state = reset_at(self._env, start)

    @torch.no_grad()
    def step(self, command: Command) -> None:
        """Moves the car on by a control period under a command."""
        state = self._state.set(keys.ACTION, torch.tensor([command]))
        self._state = self._env.step(state)["next"]
        if not self._state[keys.POSE].isfinite().all():
            raise FloatingPointError(f"the simulator diverged under the command {command}")

    @torch.no_grad()
    def measured(self) -> tuple[Triple, Triple] | None:
        """Pose and velocity as the camera sees them now, or None for a dropped frame."""
        return self._camera.see(self._state[keys.POSE][0], self._state[keys.VELOCITY][0])


KEPT = 30_000  # writes; five minutes at 100 Hz

Entry = tuple[float, float, float]
"""Stamp [s], throttle, steering."""


class SimulatedBoard:
    """The simulated PWM board: holds the last command, as a real one does, and logs all of them.

    Args:
        clock: Of the simulated car.
        failsafe: Without a write for so long its hardware makes neutral [s]; 0 has none.
        at_rest: Neutral.
    """

    def __init__(self, clock: Clock, failsafe: float = 0.0, at_rest: Command = NEUTRAL) -> None:
        self._clock, self._failsafe, self._at_rest = clock, failsafe, at_rest
        self._lock = threading.Lock()
        self._log: deque[Entry] = deque([(clock.now(), *at_rest)], maxlen=KEPT)
        self._refusing_until = self._hanging_until = self._losing_until = -math.inf

    def refuse(self, until: float) -> None:
        """Takes no write before a time [s]."""
        self._refusing_until = until

    def hang(self, until: float) -> None:
        """Answers no write before a time [s], and does none of them."""
        self._hanging_until = until

    def lose(self, until: float) -> None:
        """Says that it takes each write before a time [s], and does none of them."""
        self._losing_until = until

    def write(self, throttle: float, steering: float) -> bool:
        """Takes a command; returns whether it did."""
        now = self._clock.now()
        if now < self._hanging_until:
            self._clock.sleep(self._hanging_until - now)
            return False
        if now < self._refusing_until:
            return False
        if now < self._losing_until:
            return True
        with self._lock:
            self._log.append((now, throttle, steering))
        return True

    def acting(self) -> Command:
        """Command that acts now."""
        with self._lock:
            last = self._log[-1]
            silent = self._clock.now() - last[0]
            if self._failsafe and silent > self._failsafe and last[1:] != self._at_rest:
                last = (self._clock.now(), *self._at_rest)
                self._log.append(last)
        return last[1:]

    def since(self, stamp: float) -> list[Entry]:
        """The commands that came after a time, oldest first, and the one that acted at it."""
        with self._lock:
            found: list[Entry] = []
            for entry in reversed(self._log):
                found.append(entry)
                if entry[0] <= stamp:
                    break
        return found[::-1]
