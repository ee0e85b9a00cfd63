"""Proximal policy optimisation in many environments at once: batches, advantages and updates.

Advantages are TorchRL's `GAE`, losses are those of `losses`.

Source: Schulman et al., Proximal policy optimization algorithms, 2017.
"""

import math
import time
from collections.abc import Iterator
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.envs import EnvBase
from torchrl.modules import set_recurrent_mode
from torchrl.objectives.value import GAE

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
from buggy_rl.policies.training.collecting import (
    DistributedBatches,
    Episodes,
    ResumableCollector,
    in_process,
    stagger,
)
from buggy_rl.policies.training.losses import LOSSES, make_loss
from buggy_rl.policies.training.own_actor import STATE_VALUE, memory_of
from buggy_rl.policies.training.ppo_config import PPOConfig
from buggy_rl.policies.training.trainer import NonFiniteLossError

ADAM_EPSILON = 1e-5
LEARNED_FROM = ("advantage", "value_target")  # beside what actor and critic read and write


Report = dict[str, Tensor]
"""Scalars that a loss reports, by name."""


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
        ValueError: The batch size of the environment is not `config.cars`, or a minibatch holds no
            sequence for a recurrent actor.
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
        self.recurrent = bool(memory_of(self.actor))
        if self.recurrent and config.minibatch < config.batch_steps:
            raise ValueError(
                f"ppo.minibatch={config.minibatch} holds no sequence of ppo.batch_steps="
                f"{config.batch_steps}, by which a recurrent actor learns: raise it"
            )
        self.gae = GAE(gamma=config.discount, lmbda=config.trace, value_network=None)
        self.loss = make_loss(policy, config).to(env.device or "cpu")
        # The policy's, and those of a loss of one's own.
        self.weights = list(dict.fromkeys([*policy.parameters(), *self.loss.parameters()]))
        self.optimiser = torch.optim.Adam(
            self.weights, config.learning_rate, eps=ADAM_EPSILON, fused=True
        )
        self.collector = batches or in_process(env, self.actor, config.cars * config.batch_steps)
        self.generator = torch.Generator().manual_seed(config.seed)
        self.episodes = Episodes(env.batch_size, not config.stagger, env.device)
        self.steps = 0
        if config.stagger and isinstance(self.collector, ResumableCollector):
            stagger(env, self.collector.state, self.generator)

    def run(self) -> Iterator[dict[str, float]]:
        """Trains batch by batch.

        Yields:
            `steps`; `reward`, the mean of a step; `episode_length`, `episode_reward` and
            `waypoints` of the last finished episodes (nan before the first); what the loss reports,
            means over the update: of `clip` `loss_objective`, `loss_critic`, `kl_approx`,
            `clip_fraction`; `sd_throttle`, `sd_steering` of the exploration; `learning_rate`;
            `speed` in steps a second; `seconds_left`.

        Raises:
            NonFiniteLossError: A loss is not finite; it holds the metrics of that batch.
        """
        begun, first = time.perf_counter(), self.steps
        batches = iter(self.collector)
        while self.steps < self.config.steps:
            rate = self._set_learning_rate()
            batch = next(batches)
            reports: list[Report] = []
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

    def _metrics(self, batch: TensorDictBase, reports: list[Report]) -> dict[str, float]:
        """What is told of a batch and of the gradient steps that were made with it."""
        self.episodes.take(batch)
        told = torch.stack([torch.stack(list(report.values())) for report in reports])
        return {
            "steps": self.steps,
            "reward": batch["next", keys.REWARD].mean().item(),
            **self.episodes.means(),
            **dict(zip(reports[0], told.mean(0).tolist(), strict=True)),
            **self.policy.exploration(batch),
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
        following[asked] = self.critic(after.select(*self.critic.in_keys)[asked]).get(STATE_VALUE)
        after.set(STATE_VALUE, following)
        self.gae(batch)

    def state_dict(self) -> dict[str, Any]:
        """What a resumed run needs; on one thread in one process it goes on bit for bit."""
        return {
            "steps": self.steps,
            "policy": self.policy.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "loss": {name: tensor.clone() for name, tensor in self._of_loss()},
            "cars": cars_state(self.collector.state),
            "environment": environment_state(self.env),
            "episodes": self.episodes.state_dict(),
            "minibatches": self.generator.get_state(),
            **random_state(self.env.device),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Goes back to where `state_dict` was taken, on any device.

        On another kind of device than that of the checkpoint it goes on with other random numbers,
        and warns of it.
        """
        self.steps = state["steps"]
        self.policy.load_state_dict(state["policy"])
        self.optimiser.load_state_dict(state["optimiser"])
        with torch.no_grad():
            for name, tensor in self._of_loss():
                tensor.copy_(state["loss"][name] if "loss" in state else tensor)
        if isinstance(self.collector, ResumableCollector):
            self.collector.state = restored_cars(
                self.env, self.collector.state, state["cars"], self.actor.out_keys
            )
            self.episodes.load_state_dict(state["episodes"])
        else:  # episodes begin anew in the processes that step them
            self.episodes.load_state_dict(self.episodes.state_dict() | _last(state["episodes"]))
        restore_environment(self.env, state["environment"])
        self.generator.set_state(state["minibatches"].cpu())
        restore_random(self.env.device, state)

    def _of_loss(self) -> list[tuple[str, Tensor]]:
        """Tensors of the loss that are not the policy's, such as the weight of the kl penalty."""
        known = {id(t) for t in (*self.policy.parameters(), *self.policy.buffers())}
        tensors = [*self.loss.named_parameters(), *self.loss.named_buffers()]
        return [(name, tensor) for name, tensor in tensors if id(tensor) not in known]

    def _set_learning_rate(self) -> float:
        share = 1.0 if self.config.schedule == "constant" else 1 - self.steps / self.config.steps
        for group in self.optimiser.param_groups:
            group["lr"] = share * self.config.learning_rate
        return share * self.config.learning_rate

    def _update(self, batch: TensorDictBase, reports: list[Report]) -> None:
        """Learns from a batch [cars, time]; adds a report of each gradient step."""
        with torch.no_grad():
            self.estimate(batch)
        # A recurrent actor learns from the sequences of whole cars.
        rows = self._learned_from(batch)
        rows = rows if self.recurrent else rows.reshape(-1)
        each = rows.batch_size[1:].numel()  # steps
        sizes = minibatch_sizes(len(rows), self.config.minibatch // each)
        for _ in range(self.config.epochs):
            order = torch.randperm(len(rows), generator=self.generator)
            # Mixed at once: what is split off is then a view, not a copy by index each.
            mixed = rows[order.to(self.env.device or "cpu")]
            for part in mixed.split(sizes):
                self._descend(part, reports)
        self.policy.observe(batch[keys.OBSERVATION])

    def _learned_from(self, batch: TensorDictBase) -> TensorDictBase:
        """What the loss is given: a loss of one's own may ask for anything that is there."""
        if self.config.loss not in LOSSES:
            return batch
        read = (*self.actor.in_keys, *self.critic.in_keys)
        return batch.select(*read, *self.actor.out_keys, *LEARNED_FROM, strict=False)

    def _descend(self, rows: TensorDictBase, reports: list[Report]) -> None:
        """One gradient step, whose report is added."""
        with set_recurrent_mode(self.recurrent):
            losses = self.loss(rows)
        total = sum(value for name, value in losses.items() if name.startswith("loss_"))
        reports.append(_report(losses))
        assert isinstance(total, Tensor)
        if not math.isfinite(total.item()):
            raise NonFiniteLossError(
                f"the loss is {total.item()} after {self.steps} steps: look for what is not "
                f"finite in the batch, or lower ppo.learning_rate (now "
                f"{self.config.learning_rate})",
                rows.detach(),
            )
        self.optimiser.zero_grad(set_to_none=True)
        total.backward()
        nn.utils.clip_grad_norm_(self.weights, self.config.gradient_norm)
        self.optimiser.step()


def _report(losses: TensorDictBase) -> Report:
    """Means of what a loss reports."""
    found = {n: v.detach() for n, v in losses.items() if isinstance(v, Tensor)}
    return {name: value.mean() if value.ndim else value for name, value in found.items()}


def minibatch_sizes(rows: int, largest: int) -> list[int]:
    """Sizes of the fewest minibatches that hold all rows; they differ by one at most."""
    count = math.ceil(rows / largest)
    return [len(part) for part in torch.arange(rows).tensor_split(count)]


def _last(episodes: dict[str, Any]) -> dict[str, Any]:
    """State of `Episodes` that does not depend on who steps the environments."""
    return {"last": episodes["last"]}
