"""Our batch of cars as stable-baselines3 takes it: a `VecEnv` over the same TorchRL environment."""

# pyright: reportMissingImports=false
# stable-baselines3 may not be installed.

from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from buggy_rl.core import keys
from buggy_rl.core.keys import OBSERVATION, STEP_COUNT


class CarsVecEnv(VecEnv):
    """Cars that are reset one by one as their episodes end.

    `step` shows the first observation of the next episode where one ended; the last one of the
    old episode is in that car's info as `terminal_observation`, and `TimeLimit.truncated` says
    that it would have gone on.

    Args:
        env: From `make_env`, with a batch of cars.
        oldest: First episodes begin at random ages below this many steps; 0 for all at none.
    """

    def __init__(self, env: EnvBase, oldest: int = 0) -> None:
        self.env, self.oldest = env, oldest
        self._state: TensorDictBase | None = None
        self._actions = np.zeros(0, np.float32)
        size = env.observation_spec[OBSERVATION].shape[-1]
        shown = Box(-np.inf, np.inf, (size,), np.float32)
        super().__init__(env.batch_size.numel(), shown, Box(-1.0, 1.0, (2,), np.float32))

    def reset(self) -> NDArray[np.float32]:
        """Starts every car anew; observations [cars, size]."""
        state = self.env.reset()
        if self.oldest:
            age = state.get(STEP_COUNT)
            age.copy_(torch.randint(self.oldest, age.shape))
        self._state = state
        return state.get(OBSERVATION).numpy()

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Takes the actions [cars, 2]."""
        self._actions = actions

    @torch.no_grad()
    def step_wait(self) -> tuple[NDArray, NDArray, NDArray, list[dict[str, Any]]]:
        """Observations [cars, size], rewards [cars], dones [cars] and an info for each car."""
        if self._state is None:
            raise RuntimeError("step before reset: call reset first")
        self._state.set(keys.ACTION, torch.from_numpy(self._actions))
        stepped, following = self.env.step_and_maybe_reset(self._state)
        self._state, after = following, stepped.get("next")
        done = after.get(keys.DONE).squeeze(-1).numpy().copy()
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if done.any():
            last = after.get(OBSERVATION).numpy()
            failed = after.get(keys.TERMINATED).squeeze(-1).numpy()
            for car in np.flatnonzero(done):
                infos[car]["terminal_observation"] = last[car].copy()
                infos[car]["TimeLimit.truncated"] = not bool(failed[car])
        # A copy: the trainer adds to it in place.
        reward = after.get(keys.REWARD).squeeze(-1).numpy().copy()
        return following.get(OBSERVATION).numpy(), reward, done, infos

    def close(self) -> None:
        """Ends the simulator."""
        if not self.env.is_closed:
            self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Only what the base class asks for: cars are rows of a batch, not objects."""
        if attr_name != "render_mode":
            raise AttributeError(f"cars of a batch have no {attr_name} of their own")
        return [None] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Not possible for one car."""
        raise AttributeError(f"cars of a batch have no {attr_name} of their own")

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Not possible for one car."""
        raise AttributeError(f"cars of a batch have no {method_name} of their own")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """No car is wrapped in anything."""
        return [False] * self.num_envs
