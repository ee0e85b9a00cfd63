"""The same environment for users of Gymnasium: one car, NumPy in and out.

    import gymnasium, buggy_rl
    env = gymnasium.make("buggy_rl/Waypoints-v0", engine="mujoco")

Many cars are stepped as one batch by `gymnasium.make_vec`, see `buggy_rl.task.gym_vector`.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import gymnasium
import numpy as np
import torch
from gymnasium.spaces import Box
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torchrl.envs import EnvBase, Transform

from buggy_rl.core import keys
from buggy_rl.core.config import load_named
from buggy_rl.simulators import Factory
from buggy_rl.task.config import TaskConfig
from buggy_rl.task.env import make_env
from buggy_rl.task.gym_interface import (
    TOLD,
    Seeded,
    array,
    ends,
    observation_space,
    refuse_keywords,
    start_of,
)
from buggy_rl.task.paths.path_set import PathSet
from buggy_rl.task.registration import NAME

RENDERER = "buggy_rl.visual.film.film:Pixels"  # by name: no task needs to know how it is drawn
KEYWORDS = ("engine", "effects", "task", "paths", "render_mode", "picture")


class WaypointsEnv(Seeded, gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """One car on a path of waypoints.

    Observations are the task's `observation`, actions (throttle, steering) in [-1, 1]; the info
    holds path, pose, velocity, lateral and heading error, and what was closed or completed.

    Args:
        engine: A simulator of one car, or what `make_engine` makes one of.
        effects: Missing physics.
        task: What to do; None is the default task.
        paths: To follow instead of `task.paths`.
        render_mode: `rgb_array` for `render`, or None.
        picture: How `render` shows it, a `buggy_rl.visual.film.options.PictureConfig`.

    Raises:
        TypeError: A keyword is unknown.
        ValueError: The engine has a batch of cars, or the task or the render mode is wrong.
    """

    # pyrefly: ignore[bad-override]
    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 100}

    def __init__(
        self,
        engine: EnvBase | str | Path | Factory = "mujoco",
        effects: Sequence[Transform] = (),
        task: TaskConfig | None = None,
        paths: PathSet | None = None,
        render_mode: str | None = None,
        picture: Any = None,
        **unknown: Any,
    ) -> None:
        refuse_keywords(unknown, KEYWORDS, NAME)
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"render_mode={render_mode!r}: must be rgb_array or None")
        self.render_mode, self._picture, self._pixels = render_mode, picture, None
        self._env = make_env(engine, effects, task, paths=paths)
        if self._env.batch_size:
            raise ValueError(
                f"{NAME} drives one car, the engine has a batch of {tuple(self._env.batch_size)}: "
                "make it with batch_size=(), or use gymnasium.make_vec"
            )
        self.observation_space = observation_space(self._env)
        self.action_space = Box(-1.0, 1.0, (2,), np.float32)
        self._state: TensorDictBase | None = None

    @torch.no_grad()
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Puts the car at the start of a path; `options={"path": i}` says of which.

        Raises:
            ValueError: An option is unknown, or there is no such path.
        """
        start = start_of(options, self._env)
        super().reset(seed=seed)
        self._env.set_seed(self._drawn_seed(seed))
        self._state = self._env.reset(start, set_state=start is not None)
        if self.render_mode is not None:
            self._pixels = self._pixels or load_named(RENDERER)(self._env, self._picture)
            self._pixels.forget()
            self._pixels.record(self._state)
        return array(self._state, keys.OBSERVATION), _info(self._state)

    @torch.no_grad()
    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Drives on for one control period.

        Raises:
            RuntimeError: There was no reset yet.
        """
        if self._state is None:
            raise RuntimeError("step before reset: call reset first")
        given = torch.as_tensor(action, dtype=torch.float32, device=self._env.device)
        after = self._state = self._env.step(self._state.set(keys.ACTION, given))["next"]
        if self._pixels is not None:
            self._pixels.record(after)
        terminated, truncated = map(bool, ends(after))
        reward, observation = float(after[keys.REWARD]), array(after, keys.OBSERVATION)
        return observation, reward, terminated, truncated, _info(after)

    def render(self) -> NDArray[np.uint8] | None:
        """Pixels [H, W, 3] of the car on its path; None without `render_mode="rgb_array"`.

        Raises:
            RuntimeError: There was no reset yet.
        """
        if self.render_mode is None:
            return None
        if self._pixels is None:
            raise RuntimeError("render before reset: call reset first")
        return self._pixels.frame()

    def close(self) -> None:
        """Ends the simulator and what draws it."""
        if self._pixels is not None:
            self._pixels.close()
        if not self._env.is_closed:
            self._env.close()


def _info(state: TensorDictBase) -> dict[str, Any]:
    info = {key: state[key].item() for key in TOLD if key in state}
    return info | {key: array(state, key) for key in (keys.POSE, keys.VELOCITY)}
