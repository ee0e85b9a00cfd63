"""Short-horizon actor-critic: a policy by the gradient of the reward, through the simulator.

Source: Xu et al., Accelerated policy learning with parallel differentiable simulation, 2022; of the
worst cars, Rajeswaran et al., EPOpt: learning robust neural network policies using model ensembles,
2017.
"""

import copy
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.envs import EnvBase
from torchrl.objectives.value.functional import td_lambda_return_estimate

from buggy_rl.core import keys
from buggy_rl.policies.training.actor_critic import Policy
from buggy_rl.policies.training.checkpoint import (
    cars_state,
    environment_state,
    random_state,
    restore_environment,
    restore_random,
    restored_cars,
)
from buggy_rl.policies.training.collecting import Episodes, stagger
from buggy_rl.policies.training.trainer import NonFiniteLossError

BETAS = (0.7, 0.95)  # of Adam, as in the source: gradients change with the policy
TRIED = 2  # steps by which a gradient is looked for
LATEST = (
    0.1  # share of the last batch in a car's mean; a single one hardly ranks (docs/policies.md)
)


@dataclass(frozen=True)
class SHACConfig:
    """How a policy is trained through a differentiable simulator."""

    steps: int = 300_000
    """Steps of all environments together."""
    cars: int = 128
    """Environments stepped at once."""
    batch_steps: int = 24
    """Steps of each environment that the gradient passes (h), and between two updates."""
    learning_rate: float = 8e-3
    """Adam's of the actor, at the start."""
    critic_rate: float = 2e-3
    """Adam's of the critic, at the start."""
    schedule: Literal["linear", "constant"] = "linear"
    """Schedule of both: down to nothing over the training, or as they are."""
    epochs: int = 4
    """Passes of the critic over a batch."""
    minibatch: int = 2048
    """Steps in a gradient step of the critic."""
    discount: float = 0.98
    """Discount of the reward, a step (gamma)."""
    trace: float = 0.95
    """Decay of the critic's targets, a step (lambda)."""
    following: float = 0.5
    """Share by which the target critic follows the critic in an update."""
    smallest_sd: float = 0.05
    """Smallest standard deviation of the exploration, which the gradient alone would end."""
    gradient_norm: float = 1.0
    """Longest gradient, of actor and critic each."""
    stagger: bool = True
    """Starts the first episodes at random ages, so that resets spread over time."""
    seed: int = 0
    """Seed of the order of minibatches."""
    worst: float = 1.0
    """Share of the cars that the actor follows, those whose drive is worth least against what the
    critic expected of it: where cars differ, 0.25 trains for the worst quarter."""

    def __post_init__(self) -> None:
        if not 0.0 < self.worst <= 1.0:
            raise ValueError(
                f"shac.worst is {self.worst}: must be above 0 and at most 1, a share of the cars"
            )

    @property
    def batch(self) -> int:
        """Steps of all environments together between two updates."""
        return self.cars * self.batch_steps


class SHAC:
    """A training run through a simulator that passes gradients from commands to motion.

    The cars drive h steps from where they are, by commands u = mean + sd e of fixed e; the actor
    follows the gradient of what these steps and the critic's view of the rest are worth,

        J = mean over cars of sum_t gamma^t r_t + gamma^h V'(o_h),

    anew from each reset among them, with V' = 0 after a termination. Then the critic V learns
    TD(lambda) targets of the same steps from V', which follows it.

    With `config.worst` below 1 J is the mean over the worst cars: the conditional value at risk of
    what cars are worth beyond V' where their drives begin. V' does not see by which parameters cars
    differ, but it sees the path, so a hard path is not taken for a bad car.

    Args:
        env: Batched, with an `observation`; its reward has a slope.
        policy: Is trained in place.
        config: How.
        batches: None: gradients do not come from other processes.

    Raises:
        ValueError: The batch size of the environment is not `config.cars`, its simulator passes no
            gradient, or the actor is of one's own.
    """

    def __init__(
        self, env: EnvBase, policy: Policy, config: SHACConfig, batches: object | None = None
    ) -> None:
        if batches is not None:
            raise ValueError("algorithm=shac steps cars in this process: leave out collector")
        if env.batch_size.numel() != config.cars:
            raise ValueError(
                f"the environment has {env.batch_size.numel()} cars, shac.cars is {config.cars}: "
                "make them equal"
            )
        if policy.config.actor or policy.config.critic:
            raise ValueError("algorithm=shac trains the package's actor: leave out policy.actor")
        policy.to(env.device or "cpu")
        self.env, self.policy, self.config = env, policy, config
        self.actor, self.critic = policy.actor(), policy.value_layers
        self.target = copy.deepcopy(self.critic).requires_grad_(False)
        self.weights = {
            "actor": [*policy.mean_layers.parameters(), policy.log_sd],
            "critic": list(self.critic.parameters()),
        }
        self.rates = {"actor": config.learning_rate, "critic": config.critic_rate}
        self.optimisers = {
            name: torch.optim.Adam(weights, self.rates[name], BETAS)
            for name, weights in self.weights.items()
        }
        self.generator = torch.Generator().manual_seed(config.seed)
        self.episodes = Episodes(env.batch_size, not config.stagger, env.device)
        self.surprise = torch.zeros(config.cars, device=env.device)
        """Mean over the last batches of what each car was worth beyond the critic's view of it."""
        self.steps = 0
        refuse_without_gradient(env)
        self.cars = env.reset()
        if config.stagger:
            stagger(env, self.cars, self.generator)

    def run(self) -> Iterator[dict[str, float]]:
        """Trains batch by batch.

        Yields:
            `steps`; `reward`, the mean of a step; `episode_length`, `episode_reward` and
            `waypoints` of the last finished episodes (nan before the first); `loss_objective`, -J
            over h; `loss_critic`, its mean square error; `gradient_norm` of the actor before it is
            cut; `sd_throttle`, `sd_steering`; `learning_rate`; `speed` in steps a second;
            `seconds_left`.

        Raises:
            NonFiniteLossError: A gradient is not finite.
        """
        begun, first = time.perf_counter(), self.steps
        while self.steps < self.config.steps:
            rate = self._set_learning_rates()
            batch, gain = self._driven()
            norm = self._climb(batch, gain)
            miss = self._learn(batch)
            self.steps += batch.numel()
            self.episodes.take(batch)
            speed = (self.steps - first) / (time.perf_counter() - begun)
            yield {
                "steps": self.steps,
                "reward": batch["next", keys.REWARD].mean().item(),
                **self.episodes.means(),
                "loss_objective": -gain.item(),
                "loss_critic": miss,
                "gradient_norm": norm,
                **self.policy.exploration(batch),
                "learning_rate": rate,
                "speed": speed,
                "seconds_left": (self.config.steps - self.steps) / speed,
            }

    def state_dict(self) -> dict[str, Any]:
        """What a resumed run needs; on one thread it goes on bit for bit."""
        return {
            "steps": self.steps,
            "policy": self.policy.state_dict(),
            "target": self.target.state_dict(),
            "optimisers": {name: each.state_dict() for name, each in self.optimisers.items()},
            "cars": cars_state(self.cars),
            "environment": environment_state(self.env),
            "episodes": self.episodes.state_dict(),
            "surprise": self.surprise,
            "minibatches": self.generator.get_state(),
            **random_state(self.env.device),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Goes back to where `state_dict` was taken."""
        self.steps = state["steps"]
        self.policy.load_state_dict(state["policy"])
        self.target.load_state_dict(state["target"])
        for name, optimiser in self.optimisers.items():
            optimiser.load_state_dict(state["optimisers"][name])
        self.cars = restored_cars(self.env, self.cars, state["cars"], self.actor.out_keys)
        self.episodes.load_state_dict(state["episodes"])
        self.surprise.copy_(state["surprise"])
        restore_environment(self.env, state["environment"])
        self.generator.set_state(state["minibatches"].cpu())
        restore_random(self.env.device, state)

    def _driven(self) -> tuple[TensorDictBase, Tensor]:
        """A batch [cars, h] without gradients, and J of it with one."""
        cars, rows = self.cars.detach(), []
        with torch.enable_grad():
            for _ in range(self.config.batch_steps):
                row, cars = self.env.step_and_maybe_reset(self.actor(cars))
                rows.append(row)
            batch: Any = torch.stack(rows, -1)
            self.cars = cars
            worth = self._returns(batch, 1.0)  # (cars, h, 1)
            gain = self._gain(batch, worth)
        return batch.detach(), gain

    def _gain(self, batch: TensorDictBase, worth: Tensor) -> Tensor:
        """J over h of the cars that the actor follows."""
        begins = batch["next", keys.DONE].roll(1, -2)
        begins[..., 0, :] = True
        gains = worth * begins
        if self.config.worst < 1.0:
            gains = gains.flatten(0, -3)[self._worst(batch, gains.detach(), begins)]
        return gains.sum() / gains.numel()

    @torch.no_grad()
    def _worst(self, batch: TensorDictBase, gains: Tensor, begins: Tensor) -> Tensor:
        """Indices [k] of the cars that are worth least against V' where their drives begin."""
        expected = self.target(self.policy.scaling(batch[keys.OBSERVATION])) * begins
        surprise = (gains - expected).sum((-2, -1)).flatten()
        self.surprise.lerp_(surprise, LATEST)
        count = max(1, round(self.config.worst * len(surprise)))
        return self.surprise.topk(count, largest=False).indices

    def _returns(self, batch: TensorDictBase, trace: float) -> Tensor:
        """Returns [cars, h, 1] of every step, of TD(lambda) with the target critic's values."""
        after = batch["next"]
        value = self.target(self.policy.scaling(after[keys.OBSERVATION]))
        done = after[keys.DONE].clone()
        done[..., -1, :] = True
        return td_lambda_return_estimate(
            self.config.discount, trace, value, after[keys.REWARD], done, after[keys.TERMINATED]
        )

    def _climb(self, batch: TensorDictBase, gain: Tensor) -> float:
        """A step of the actor; the length of its gradient."""
        norm = self._descend("actor", -gain, batch)
        with torch.no_grad():
            self.policy.log_sd.clamp_(math.log(self.config.smallest_sd))
        return norm

    def _learn(self, batch: TensorDictBase) -> float:
        """Passes of the critic over a batch; its mean square error in the last."""
        with torch.no_grad():
            target = self._returns(batch, self.config.trace).flatten(0, 1)  # (N, 1)
            seen = batch[keys.OBSERVATION].flatten(0, 1)
            scaled = self.policy.scaling(seen)
        misses = []
        for _ in range(self.config.epochs):
            order = torch.randperm(len(scaled), generator=self.generator)
            for part in order.split(self.config.minibatch):
                miss = nn.functional.mse_loss(self.critic(scaled[part]), target[part])
                self._descend("critic", miss, batch)
                misses.append(miss.detach())
        with torch.no_grad():
            pairs = zip(self.weights["critic"], self.target.parameters(), strict=True)
            for own, follows in pairs:
                follows.lerp_(own, self.config.following)
        self.policy.observe(seen)
        return torch.stack(misses).mean().item()

    def _descend(self, name: str, loss: Tensor, batch: TensorDictBase) -> float:
        """A gradient step of actor or critic; the length of the gradient before it is cut."""
        self.optimisers[name].zero_grad(set_to_none=True)
        loss.backward()
        norm = nn.utils.clip_grad_norm_(self.weights[name], self.config.gradient_norm).item()
        if not math.isfinite(norm):
            raise NonFiniteLossError(
                f"the gradient of the {name} is {norm} after {self.steps} steps: look for what is "
                f"not finite in the batch, or has no slope, in simulator, effects or reward",
                batch,
            )
        self.optimisers[name].step()
        return norm

    def _set_learning_rates(self) -> float:
        """Sets them for the next update; that of the actor."""
        share = 1.0 if self.config.schedule == "constant" else 1 - self.steps / self.config.steps
        for name, optimiser in self.optimisers.items():
            for group in optimiser.param_groups:
                group["lr"] = share * self.rates[name]
        return share * self.rates["actor"]


def refuse_without_gradient(env: EnvBase) -> None:
    """Tries whether a step passes the gradient of a command to reward and motion.

    Raises:
        ValueError: It does not.
    """
    with torch.random.fork_rng(), torch.enable_grad():
        cars = env.reset()
        action = torch.full(env.full_action_spec[keys.ACTION].shape, 0.1, requires_grad=True)
        for _ in range(TRIED):
            cars = env.step_mdp(env.step(cars.set(keys.ACTION, action)))
        if not cars[keys.VELOCITY].requires_grad:
            raise ValueError(
                "algorithm=shac follows gradients from commands to motion, and this simulator "
                "passes none: take a learned one, single_track or kinematic, or surrogate over "
                "this one (docs/policies.md), or algorithm=ppo"
            )
