"""The simulator and its camera, one control period at a time."""

from typing import Any

import torch
from tensordict import TensorDict

from buggy_rl import keys
from buggy_rl.car.interfaces import Command, neutral_of
from buggy_rl.longitudinal import declared_by
from buggy_rl.simulated_car.config import SimulatedCarConfig
from buggy_rl.simulated_car.live_camera import LiveCamera, Triple
from buggy_rl.task.env import make_simulator

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
            self._state = self._env.reset(start.clone())
            self.step(neutral_of(config.two_way))
        self._state = self._env.reset(start)

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
