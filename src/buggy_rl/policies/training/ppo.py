"""Proximal policy optimisation in many environments at once: its loss and its update.

Advantages are TorchRL's `GAE`, the loss is its `ClipPPOLoss` without what is not logged.

Source: Schulman et al., Proximal policy optimization algorithms, 2017.
"""

import math
import os
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torchrl.envs import EnvBase, StepCounter
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from buggy_rl.core import keys
from buggy_rl.policies.training.actor_critic import Policy
from buggy_rl.policies.training.checkpoint import (
    environment_state,
    refuse_difference,
    restore_environment,
)
from buggy_rl.policies.training.collecting import (
    DistributedBatches,
    Episodes,
    ResumableCollector,
    in_process,
)

STATE_VALUE = "state_value"  # the critic's output
ADAM_EPSILON = 1e-5
LONG = 1_000_000  # steps from which a compiled update saves more time than compiling it takes
SMALLEST_SD = 1e-4  # of an advantage, as in TorchRL
LEARNED_FROM = (keys.OBSERVATION, keys.ACTION, "action_log_prob", "advantage", "value_target")
REPORTED = ("loss_objective", "loss_critic", "kl_approx", "clip_fraction")


@dataclass(frozen=True)
class PPOConfig:
    """How a policy is trained; `configs/ppo_original.yaml` holds the original study's settings."""

    steps: int = 3_000_000
    """Steps of all environments together."""
    cars: int = 256
    """Environments stepped at once."""
    batch_steps: int = 32
    """Steps of each environment between two updates."""
    epochs: int = 5
    """Passes over a batch in an update."""
    minibatch: int = 2048
    """Most steps in a gradient step; a batch is divided into as few equal parts as that allows."""
    learning_rate: float = 3e-3
    """Adam's, at the start."""
    schedule: Literal["linear", "constant"] = "linear"
    """Schedule of the learning rate: down to nothing over the training, or as it is."""
    discount: float = 0.98
    """Discount of the reward, a step (gamma)."""
    trace: float = 0.95
    """Decay of the advantage estimate, a step (lambda)."""
    clip: float = 0.2
    """Clipping of the likelihood ratio, either way."""
    value_weight: float = 0.5
    """Weight of the critic's loss."""
    entropy_weight: float = 0.0
    """Weight of the entropy bonus; 0 leaves it out."""
    gradient_norm: float = 1.0
    """Longest gradient."""
    stagger: bool = True
    """Starts the first episodes at random ages, so that resets spread over time."""
    seed: int = 0
    """Seed of the order of minibatches."""
    compiled: Literal["auto", "always", "never"] = "auto"
    """Whether PyTorch compiles loss and gradient; auto: where a C++ compiler is at hand and the
    training has a million steps. The numbers are the same to rounding."""


def compiles(config: PPOConfig) -> bool:
    """Whether a training compiles its update.

    Raises:
        ValueError: It shall, and there is no C++ compiler.
    """
    if config.compiled == "never" or (config.compiled == "auto" and config.steps < LONG):
        return False
    compiler = shutil.which(os.environ.get("CXX", "g++")) or shutil.which("clang++")
    if config.compiled == "always" and not compiler:
        raise ValueError("ppo.compiled=always needs a C++ compiler: install g++, or leave it out")
    return bool(compiler)


class NonFiniteLossError(FloatingPointError):
    """The loss is not a number any more.

    Args:
        message: What is wrong.
        batch: Rows that the loss was computed from.
        metrics: Row of the log of the batch that holds them; the means are over the minibatches up
            to the failed one.
    """

    def __init__(
        self, message: str, batch: TensorDictBase, metrics: dict[str, float] | None = None
    ) -> None:
        super().__init__(message)
        self.batch, self.metrics = batch, metrics or {}


class ClippedLoss(ClipPPOLoss):
    """L = -mean min(r A, clip(r, 1 - eps, 1 + eps) A) + c_v mean (V - R)^2 - c_e mean H.

    r = pi(a|s) / pi_old(a|s), A the advantages of the minibatch less their mean and over their
    standard deviation. The same numbers and gradients as `ClipPPOLoss` with `functional=False`,
    `loss_critic_type="l2"` and `normalize_advantage=True`, which are fixed. Left out are effective
    sample size, extremes of r, and copies of TensorDicts.

    Args:
        args, options: As for `ClipPPOLoss`.
        compiled: Whether PyTorch compiles loss and gradient, which takes a C++ compiler and some
            ten seconds, and makes them twice as fast. The numbers are the same to rounding.
    """

    clip_epsilon: Tensor
    critic_coeff: Tensor
    entropy_coeff: Tensor

    def __init__(self, *args: Any, compiled: bool = False, **options: Any) -> None:
        super().__init__(*args, **options)
        epsilon = float(self.clip_epsilon)
        self._bounds = math.log1p(-epsilon), math.log1p(epsilon)
        self._weights = (
            float(self.critic_coeff),
            float(self.entropy_coeff) if self.entropy_bonus else 0.0,
        )
        parts: Callable[..., tuple[Tensor, ...]] = self._parts
        self._of_rows = torch.compile(parts, dynamic=False, fullgraph=True) if compiled else parts

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Losses and what is reported of them, for rows [N] with their advantages."""
        parts = self._of_rows(*(tensordict.get(key) for key in LEARNED_FROM))
        names = (*REPORTED, "loss_entropy")  # the last with an entropy bonus only
        return TensorDict(dict(zip(names, parts, strict=False)))

    def _parts(
        self,
        observation: Tensor,
        action: Tensor,
        sampled: Tensor,
        advantage: Tensor,
        target: Tensor,
    ) -> tuple[Tensor, ...]:
        """Values of `REPORTED` and, with an entropy bonus, its loss.

        Args:
            observation: [N, size]
            action: [N, 2]
            sampled: [N] log density of the action when it was drawn.
            advantage: [N, 1]
            target: [N, 1] of the value.
        """
        actor: Any = self.actor_network
        drawn = actor.distribution(observation)
        log_ratio = (drawn.log_prob(action) - sampled).unsqueeze(-1)  # (N, 1)
        clipped = log_ratio.clamp(*self._bounds)
        scaled = _standardised(advantage)
        gain = torch.minimum(log_ratio.exp() * scaled, clipped.exp() * scaled)
        critic: Any = self.critic_network
        miss = torch.nn.functional.mse_loss(critic.module(observation), target)
        of_critic, of_entropy = self._weights
        found = (
            -gain.mean(),
            of_critic * miss,
            -log_ratio.detach().mean(),
            (clipped.detach() != log_ratio.detach()).float().mean(),
        )
        if self.entropy_bonus:
            found = (*found, -of_entropy * drawn.entropy().mean())
        return found


def _standardised(advantage: Tensor) -> Tensor:
    if advantage.numel() == 1:  # has no standard deviation; TorchRL leaves it as it is, too
        return advantage
    sd, mean = torch.std_mean(advantage)
    return (advantage - mean) / sd.clamp_min(SMALLEST_SD)


class PPO:
    """A training run that can be stopped after any batch and goes on as if it never had been.

    The value after a termination is 0; after a truncation it is the critic's, of the episode's last
    observation:

    delta_t = r_t + gamma V(s_t+1) (1 - terminated_t) - V(s_t)
    A_t = delta_t + gamma lambda A_t+1 (1 - done_t)

    Args:
        env: Batched, with an `observation` and a step counter; it clamps actions of any size.
        policy: Is trained in place.
        config: How.
        batches: Of [cars, time] from elsewhere, by the policy as it is; None steps `env` here.

    Raises:
        ValueError: The batch size of the environment is not `config.cars`.
    """

    def __init__(
        self,
        env: EnvBase,
        policy: Policy,
        config: PPOConfig,
        batches: DistributedBatches | None = None,
    ) -> None:
        if env.batch_size.numel() != config.cars:
            raise ValueError(
                f"the environment has {env.batch_size.numel()} cars, ppo.cars is {config.cars}: "
                "make them equal"
            )
        policy.to(env.device or "cpu")
        self.env, self.policy, self.config = env, policy, config
        self.actor, self.critic = policy.actor(), policy.critic()
        self.gae = GAE(gamma=config.discount, lmbda=config.trace, value_network=None)
        self.loss = ClippedLoss(
            self.actor,  # pyright: ignore[reportArgumentType]  # all it needs is get_dist
            self.critic,
            clip_epsilon=config.clip,
            loss_critic_type="l2",
            critic_coeff=config.value_weight,
            normalize_advantage=True,
            entropy_bonus=config.entropy_weight > 0,
            entropy_coeff=config.entropy_weight or None,
            functional=False,  # it has no target networks, for which it would swap weights
            compiled=compiles(config),
        )
        self.optimiser = torch.optim.Adam(
            policy.parameters(), config.learning_rate, eps=ADAM_EPSILON, fused=True
        )
        self.collector = batches or in_process(env, self.actor, config.cars * config.batch_steps)
        self.generator = torch.Generator().manual_seed(config.seed)
        self.episodes = Episodes(env.batch_size, not config.stagger, env.device)
        self.steps = 0
        if config.stagger and isinstance(self.collector, ResumableCollector):
            self._stagger(self.collector.state)

    def run(self) -> Iterator[dict[str, float]]:
        """Trains batch by batch.

        Yields:
            `steps`; `reward`, the mean of a step; `episode_length`, `episode_reward` and
            `waypoints` of the last finished episodes (nan before the first); `loss_objective`,
            `loss_critic`, `kl_approx`, `clip_fraction`, means over the update; `sd_throttle`,
            `sd_steering` of the exploration; `learning_rate`; `speed` in steps a second;
            `seconds_left`.

        Raises:
            NonFiniteLossError: A loss is not finite; it holds the metrics of that batch.
        """
        begun, first = time.perf_counter(), self.steps
        batches = iter(self.collector)
        while self.steps < self.config.steps:
            rate = self._set_learning_rate()
            batch = next(batches)
            reports: list[Tensor] = []
            failure: NonFiniteLossError | None = None
            try:
                self._update(batch, reports)
            except NonFiniteLossError as error:
                failure = error
            self.steps += batch.numel()
            metrics = self._metrics(batch, reports)
            speed = (self.steps - first) / (time.perf_counter() - begun)
            left = (self.config.steps - self.steps) / speed
            metrics |= {"learning_rate": rate, "speed": speed, "seconds_left": left}
            if failure is not None:
                failure.metrics = metrics
                raise failure
            yield metrics

    def _metrics(self, batch: TensorDictBase, reports: list[Tensor]) -> dict[str, float]:
        """What is told of a batch and of the gradient steps that were made with it."""
        self.episodes.take(batch)
        means = torch.stack(reports).mean(0).tolist()
        throttle, steering = self.policy.log_sd.exp().tolist()
        return {
            "steps": self.steps,
            "reward": batch["next", keys.REWARD].mean().item(),
            **self.episodes.means(),
            **dict(zip(REPORTED, means, strict=True)),
            "sd_throttle": throttle,
            "sd_steering": steering,
        }

    def estimate(self, batch: TensorDictBase) -> None:
        """Writes values, `advantage` and `value_target` of a batch [cars, time].

        The critic is evaluated once for each state: the state after a step is the next step's,
        except where an episode or the batch ends.
        """
        after = batch.get("next")
        value = self.critic(batch).get(STATE_VALUE)  # (cars, time, 1)
        following = value.roll(-1, -2)
        asked = after.get(keys.DONE).squeeze(-1).clone()
        asked[..., -1] = True
        following[asked] = self.critic(after.select(keys.OBSERVATION)[asked]).get(STATE_VALUE)
        after.set(STATE_VALUE, following)
        self.gae(batch)

    def state_dict(self) -> dict[str, Any]:
        """What a resumed run needs; on one thread in one process it goes on bit for bit."""
        cars = self.collector.state
        return {
            "steps": self.steps,
            "policy": self.policy.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "cars": {} if cars is None else cars.clone().flatten_keys(".").to_dict(),
            "environment": environment_state(self.env),
            "episodes": self.episodes.state_dict(),
            "minibatches": self.generator.get_state(),
            "random": torch.get_rng_state(),
            "random_device": self._device_random(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Goes back to where `state_dict` was taken."""
        self.steps = state["steps"]
        self.policy.load_state_dict(state["policy"])
        self.optimiser.load_state_dict(state["optimiser"])
        if isinstance(self.collector, ResumableCollector):
            self.collector.state = self._cars(self.collector.state, state["cars"])
            self.episodes.load_state_dict(state["episodes"])
        else:  # episodes begin anew in the processes that step them
            self.episodes.load_state_dict(self.episodes.state_dict() | _last(state["episodes"]))
        restore_environment(self.env, state["environment"])
        self.generator.set_state(state["minibatches"])
        torch.set_rng_state(state["random"])  # last: whatever is built draws from it
        if state.get("random_device") is not None:
            torch.cuda.set_rng_state(state["random_device"], self.env.device or "cuda")

    def _device_random(self) -> Tensor | None:
        """State of the generator that exploration draws from on a GPU; None on the CPU."""
        device = self.env.device
        on_gpu = device is not None and device.type == "cuda"
        return torch.cuda.get_rng_state(device) if on_gpu else None

    def _cars(self, here: TensorDictBase, saved: dict[str, Any]) -> TensorDictBase:
        written = self.actor.out_keys  # anew by every step
        cars = TensorDict(saved, self.env.batch_size, device=self.env.device).exclude(*written)
        refuse_difference(here.flatten_keys(".").exclude(*written).keys(), cars.keys())
        return cars.unflatten_keys(".").clone()

    def _stagger(self, cars: TensorDictBase) -> None:
        """Draws the ages of the first episodes uniformly, as after long collection."""
        limits = [part.max_steps for part in self.env.modules() if isinstance(part, StepCounter)]
        limit = min((limit for limit in limits if limit), default=0)
        if limit:
            age = cars[keys.STEP_COUNT]
            age.copy_(torch.randint(limit, age.shape, generator=self.generator))

    def _set_learning_rate(self) -> float:
        share = 1.0 if self.config.schedule == "constant" else 1 - self.steps / self.config.steps
        for group in self.optimiser.param_groups:
            group["lr"] = share * self.config.learning_rate
        return share * self.config.learning_rate

    def _update(self, batch: TensorDictBase, reports: list[Tensor]) -> None:
        """Learns from a batch [cars, time]; adds a report [4] of each gradient step."""
        with torch.no_grad():
            self.estimate(batch)
        rows = batch.select(*LEARNED_FROM).reshape(-1)
        sizes = minibatch_sizes(len(rows), self.config.minibatch)
        for _ in range(self.config.epochs):
            order = torch.randperm(len(rows), generator=self.generator)
            # Mixed at once: what is split off is then a view, not a copy by index each.
            mixed = rows[order.to(self.env.device or "cpu")]
            for part in mixed.split(sizes):
                self._descend(part, reports)
        self.policy.observe(rows[keys.OBSERVATION])

    def _descend(self, rows: TensorDictBase, reports: list[Tensor]) -> None:
        """One gradient step, whose report [4] is added."""
        losses = self.loss(rows)
        total = losses["loss_objective"] + losses["loss_critic"]
        if self.config.entropy_weight:
            total = total + losses["loss_entropy"]
        reports.append(torch.stack([losses[name].detach() for name in REPORTED]))
        if not math.isfinite(total.item()):
            raise NonFiniteLossError(
                f"the loss is {total.item()} after {self.steps} steps: look for what is not "
                f"finite in the batch, or lower ppo.learning_rate (now "
                f"{self.config.learning_rate})",
                rows.detach(),
            )
        self.optimiser.zero_grad(set_to_none=True)
        total.backward()
        nn.utils.clip_grad_norm_(self.policy.parameters(), self.config.gradient_norm)
        self.optimiser.step()


def minibatch_sizes(rows: int, largest: int) -> list[int]:
    """Sizes of the fewest minibatches that hold all rows; they differ by one at most."""
    count = math.ceil(rows / largest)
    return [len(part) for part in torch.arange(rows).tensor_split(count)]


def _last(episodes: dict[str, Any]) -> dict[str, Any]:
    """State of `Episodes` that does not depend on who steps the environments."""
    return {"last": episodes["last"]}
