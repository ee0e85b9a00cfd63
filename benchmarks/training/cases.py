"""The three trainings that are compared, each behind the same two methods."""

# pyright: reportMissingImports=false
# stable-baselines3 may not be installed.

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

import gymnasium
import stable_baselines3
import torch
import yaml
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv, VecNormalize
from tensordict import TensorDictBase
from torchrl.envs import TransformedEnv

from buggy_rl.core import keys
from buggy_rl.core.config import build
from buggy_rl.core.keys import OBSERVATION
from buggy_rl.policies.closed_loop import Driver
from buggy_rl.policies.training.actor_critic import ACTIVATIONS, OBSERVATION_LIMIT
from buggy_rl.policies.training.ppo import ADAM_EPSILON, PPO
from buggy_rl.policies.training.run import PolicyRunConfig, new_policy, validation_task
from buggy_rl.simulators import make_engine
from buggy_rl.task.env import make_env
from buggy_rl.task.gym import NAME
from buggy_rl.task.paths.making import make_paths
from engines import make
from training.cars import CarsVecEnv

ROOT = Path(__file__).parents[2]
ENDLESS = 10**12  # steps: more than any measurement takes

Watch = Callable[[int], bool]
"""Is told the steps so far, first at none and then after each whole batch; False ends it."""


class Training(Protocol):
    """A policy in training."""

    def train(self, watch: Watch) -> None:
        """Trains batch by batch until `watch` says no or the steps are used up."""
        ...

    def driver(self) -> Driver:
        """Drives by the most likely action of the policy as it now is."""
        ...


def read_settings(sources: Sequence[str], seed: int) -> PolicyRunConfig:
    """A run's config from YAML files (seen from the repository) and key=value overrides."""
    found = [s if "=" in s else str(ROOT / s) for s in sources]
    return build(PolicyRunConfig, [*found, "output=nowhere", f"seed={seed}", f"ppo.seed={seed}"])


def make_simulator(name: str, cars: tuple[int, ...], threads: int) -> Any:
    """An engine's name (`learned`: an untrained history MLP), a .pt or a .yaml."""
    if name.endswith((".yaml", ".yml")):
        of_mujoco = yaml.safe_load(Path(name).read_text())["engine"] == "mujoco"
        options: dict[str, Any] = {"nthread": threads} if of_mujoco else {}
        return make_engine(name, cars, **options)
    return make(name, cars, "cpu", threads)


def validation_environment(simulator: str, threads: int, run: PolicyRunConfig) -> TransformedEnv:
    """One car on each of the validation paths."""
    task = validation_task(run.task)
    paths = make_paths(task.paths)
    return make_env(make_simulator(simulator, (len(paths),), threads), task=task, paths=paths)


class Ours:
    """`buggy_rl.policies.training.ppo.PPO` over the batched environment."""

    def __init__(self, simulator: str, threads: int, run: PolicyRunConfig) -> None:
        torch.manual_seed(run.seed)
        cars = make_simulator(simulator, (run.ppo.cars,), threads)
        env = make_env(cars, task=run.task)
        self.policy = new_policy(env, run.policy)
        self.ppo = PPO(env, self.policy, run.ppo)

    def train(self, watch: Watch) -> None:
        """Trains batch by batch."""
        if not watch(0):
            return
        for _ in self.ppo.run():
            if not watch(self.ppo.steps):
                return

    def driver(self) -> Driver:
        """The policy's own."""
        return self.policy.driver()


class StableBaselines:
    """stable-baselines3's PPO with a run's settings.

    Args:
        env: A Gymnasium environment, or cars as a `VecEnv`.
        run: The settings.
        adam: Further settings of the optimiser.
    """

    def __init__(
        self,
        env: gymnasium.Env | VecEnv,
        run: PolicyRunConfig,
        adam: dict[str, Any] | None = None,
    ) -> None:
        ppo, policy = run.ppo, run.policy
        self.normaliser: VecNormalize | None = None
        if policy.scaling == "running":
            if not isinstance(env, VecEnv):
                raise ValueError("policy.scaling is running: only measured over a VecEnv")
            # The nearest thing to the scaling in our policy. Its statistics move at every step,
            # ours between batches.
            env = VecNormalize(env, norm_reward=False, clip_obs=OBSERVATION_LIMIT)
            self.normaliser = env
        self.steps = ppo.steps
        self.model = stable_baselines3.PPO(
            "MlpPolicy",
            env,
            learning_rate=_schedule(run),
            n_steps=ppo.batch_steps,
            batch_size=ppo.minibatch,
            n_epochs=ppo.epochs,
            gamma=ppo.discount,
            gae_lambda=ppo.trace,
            clip_range=ppo.clip,
            ent_coef=ppo.entropy_weight,
            vf_coef=ppo.value_weight,
            max_grad_norm=ppo.gradient_norm,
            policy_kwargs={
                "net_arch": {"pi": policy.hidden, "vf": policy.hidden},
                "activation_fn": ACTIVATIONS[policy.activation],
                "log_std_init": math.log(policy.initial_sd),
                "optimizer_kwargs": {"eps": ADAM_EPSILON, **(adam or {})},
            },
            seed=run.seed,
            device="cpu",
        )

    def train(self, watch: Watch) -> None:
        """Trains batch by batch."""
        self.model.learn(self.steps, callback=_Watched(watch))

    def driver(self) -> Driver:
        """The mean of the policy's actions; observations normalised as in training."""

        def act(tensordict: TensorDictBase) -> TensorDictBase:
            observation = tensordict[OBSERVATION].numpy()
            if self.normaliser is not None:
                observation = self.normaliser.normalize_obs(observation)
            action, _ = self.model.predict(observation, deterministic=True)
            return tensordict.set(keys.ACTION, torch.from_numpy(action))

        return act


class _Watched(BaseCallback):
    """Tells at the beginning of each rollout, which is when all before it is learned."""

    def __init__(self, watch: Watch) -> None:
        super().__init__()
        self.watch, self.wanted = watch, True

    def _on_rollout_start(self) -> None:
        self.wanted = self.watch(self.num_timesteps)

    def _on_step(self) -> bool:
        return self.wanted

    def _on_training_end(self) -> None:
        if self.wanted:  # the steps are used up
            self.watch(self.num_timesteps)


def _schedule(run: PolicyRunConfig) -> float | Callable[[float], float]:
    """The learning rate, or how it follows from the share of the training still to come."""
    start = run.ppo.learning_rate
    return start if run.ppo.schedule == "constant" else lambda remaining: remaining * start


def stable_original(simulator: str, threads: int, run: PolicyRunConfig) -> StableBaselines:
    """As the original study used it: one car in one Gymnasium environment."""
    engine = make_simulator(simulator, (), threads)
    return StableBaselines(gymnasium.make(NAME, engine=engine, task=run.task), run)


def stable_batched(simulator: str, threads: int, run: PolicyRunConfig) -> StableBaselines:
    """Over the same batch of cars as ours, with our settings and our fused Adam."""
    env = make_env(make_simulator(simulator, (run.ppo.cars,), threads), task=run.task)
    limit = run.task.transforms["step_limit"].options["max_steps"]
    cars = CarsVecEnv(env, oldest=limit if run.ppo.stagger else 0)
    return StableBaselines(cars, run, adam={"fused": True})


CASES: dict[str, Callable[[str, int, PolicyRunConfig], Training]] = {
    "original": stable_original,
    "batched": stable_batched,
    "ours": Ours,
}
