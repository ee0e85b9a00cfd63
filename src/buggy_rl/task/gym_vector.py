"""Many cars for users of Gymnasium: one batch of tensors, NumPy in and out.

import gymnasium, buggy_rl
envs = gymnasium.make_vec("buggy_rl/Waypoints-v0", num_envs=4096, engine="single_track")
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torchrl.envs import EnvBase, Transform

from buggy_rl.core import keys
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

KEYWORDS = ("num_envs", "engine", "effects", "task", "paths", "device")
Rows = NDArray[np.float32]
Flags = NDArray[np.bool_]


class WaypointsVectorEnv(Seeded, VectorEnv[Rows, Rows, NDArray[Any]]):
    """Cars on paths of waypoints, all of them one step of one batched environment.

    A car whose episode ends is reset within the same step, as TorchRL's partial reset does: no
    action is given away, and `final_obs` and `final_info` hold what it ended with.

    Args:
        num_envs: Number of cars N.
        engine: A simulator with a batch of N, or what `make_engine` makes one of.
        effects: Missing physics.
        task: What to do; None is the default task.
        paths: To follow instead of `task.paths`.
        device: Where an engine that is still to be made computes.

    Raises:
        TypeError: A keyword is unknown.
        ValueError: The engine has another batch, or the task is wrong.
    """

    # pyrefly: ignore[bad-override]
    metadata: ClassVar[dict[str, Any]] = {
        "render_modes": [],
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        engine: EnvBase | str | Path | Factory = "mujoco",
        effects: Sequence[Transform] = (),
        task: TaskConfig | None = None,
        paths: PathSet | None = None,
        device: str = "cpu",
        **unknown: Any,
    ) -> None:
        refuse_keywords(unknown, KEYWORDS, f"{NAME} with many cars")
        self._env = make_env(engine, effects, task, num_envs, device, paths)
        if self._env.batch_size != (num_envs,):
            raise ValueError(
                f"num_envs is {num_envs}, the engine has a batch of {tuple(self._env.batch_size)}: "
                f"make it with batch_size={num_envs}"
            )
        self.num_envs = num_envs
        self.single_observation_space = observation_space(self._env)
        self.single_action_space = Box(-1.0, 1.0, (2,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._state: TensorDictBase | None = None

    @torch.no_grad()
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Rows, dict[str, Any]]:
        """Puts all cars at starts; `options={"path": i}` says of which path, or of which each.

        Raises:
            ValueError: An option is unknown, or there is no such path.
        """
        start = start_of(options, self._env)
        super().reset(seed=seed)
        self._env.set_seed(self._drawn_seed(seed))
        self._state = self._env.reset(start, set_state=start is not None)
        return array(self._state, keys.OBSERVATION), _infos(self._state)

    @torch.no_grad()
    def step(self, actions: Rows) -> tuple[Rows, NDArray[Any], Flags, Flags, dict[str, Any]]:
        """Drives on for one control period, and resets the cars whose episodes end.

        Args:
            actions: Throttle and steering [N, 2].

        Raises:
            RuntimeError: There was no reset yet.
            ValueError: The actions have another shape.
        """
        if self._state is None:
            raise RuntimeError("step before reset: call reset first")
        given = torch.as_tensor(actions, dtype=torch.float32, device=self._env.device)
        if given.shape != (self.num_envs, 2):
            raise ValueError(f"actions have shape {list(given.shape)}, not [{self.num_envs}, 2]")
        self._state.set(keys.ACTION, given)
        stepped, self._state = self._env.step_and_maybe_reset(self._state)
        after = stepped["next"]
        terminated, truncated = (flag.squeeze(-1).cpu().numpy().copy() for flag in ends(after))
        infos = _infos(self._state) | _final(after, terminated | truncated)
        rewards = array(after, keys.REWARD).squeeze(-1).astype(np.float64)  # Gymnasium's precision
        return array(self._state, keys.OBSERVATION), rewards, terminated, truncated, infos

    def close_extras(self, **kwargs: Any) -> None:
        """Ends the simulator."""
        if not self._env.is_closed:
            self._env.close()


def _infos(state: TensorDictBase, of: Flags | None = None) -> dict[str, Any]:
    """Infos of cars, each with Gymnasium's mask of the cars that have it; zero for the others."""
    has = np.ones(state.batch_size, np.bool_) if of is None else of
    infos: dict[str, Any] = {}
    for key in (*TOLD, keys.POSE, keys.VELOCITY):
        if key in state:
            values = array(state, key)
            if key in TOLD:
                values = values.squeeze(-1)
                values = values.astype(np.float64) if values.dtype.kind == "f" else values
            values[~has] = 0
            infos[key], infos[f"_{key}"] = values, has.copy()
    return infos


def _final(after: TensorDictBase, ended: Flags) -> dict[str, Any]:
    """What cars ended with, in Gymnasium's form; nothing in a step that ends no episode."""
    if not ended.any():
        return {}
    last, rows = np.full(len(ended), None, object), array(after, keys.OBSERVATION)
    for index in ended.nonzero()[0]:
        last[index] = rows[index]
    infos = {"final_obs": last, "final_info": _infos(after, ended)}
    return infos | {f"_{name}": ended.copy() for name in infos}
