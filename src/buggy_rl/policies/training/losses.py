"""Losses of actor and critic: TorchRL's, one that is its ClipPPOLoss sooner, or one's own."""

import inspect
import os
import shutil
from collections.abc import Callable
from typing import Any, ClassVar

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.modules import ValueOperator
from torchrl.objectives import A2CLoss, ClipPPOLoss, KLPENPPOLoss, LossModule

from buggy_rl.core import keys, trust
from buggy_rl.core.config import load_named, one_line
from buggy_rl.policies.training.actor_critic import Actor, Policy
from buggy_rl.policies.training.ppo_config import PPOConfig

LONG = 1_000_000  # steps from which a compiled update saves more time than compiling it takes
SMALLEST_SD = 1e-4  # of an advantage, as in TorchRL
REPORTED = ("loss_objective", "loss_critic", "kl_approx", "clip_fraction")
FIXED = {"functional": False, "loss_critic_type": "l2", "normalize_advantage": True}
"""Arguments of a loss that are the same in every training; no target networks need `functional`."""
SETTINGS = {
    "clip": "clip_epsilon",
    "value_weight": "critic_coeff",
    "entropy_weight": "entropy_coeff",
}
"""Settings of PPO -> arguments of a loss."""


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


class ClippedLoss(ClipPPOLoss):
    """L = -mean min(r A, clip(r, 1 - eps, 1 + eps) A) + c_v mean (V - R)^2 - c_e mean H.

    r = pi(a|s) / pi_old(a|s), A the advantages of the minibatch less their mean and over their
    standard deviation. Where actor, critic and arguments are those of our own trainings (`fast`)
    the same numbers and gradients as `ClipPPOLoss` without effective sample size, extremes of r,
    and copies of TensorDicts; otherwise `ClipPPOLoss` itself.

    Args:
        args, options: As for `ClipPPOLoss`.
        compiled: Whether PyTorch compiles loss and gradient, which takes a C++ compiler and some
            ten seconds, and makes them twice as fast. The numbers are the same to rounding.
    """

    clip_epsilon: Tensor
    critic_coeff: Tensor
    entropy_coeff: Tensor
    own: ClassVar[set[str]] = {"forward", "get_dist", "distribution"}
    """Methods of the actor that must be its class's."""

    def __init__(self, *args: Any, compiled: bool = False, **options: Any) -> None:
        super().__init__(*args, **options)
        known = {*FIXED, *SETTINGS.values(), "entropy_bonus"} >= set(options)
        fixed = all(options.get(name) == value for name, value in FIXED.items())
        self._usual = known and fixed and isinstance(options.get("clip_epsilon", 0.2), float)
        parts: Callable[..., tuple[Tensor, ...]] = self._parts
        self._of_rows = torch.compile(parts, dynamic=False, fullgraph=True) if compiled else parts

    @property
    def fast(self) -> bool:
        """Whether actor, critic and arguments are ours and nothing of them was overridden."""
        actor, critic = self.actor_network, self.critic_network
        ours = type(self) is ClippedLoss and type(actor) is Actor and type(critic) is ValueOperator
        return (
            ours
            and self._usual
            and not self.own & vars(actor).keys()
            and critic.in_keys == [keys.OBSERVATION]
            and self.critic_coeff is not None
        )

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Losses and what is reported of them, for rows [N] with their advantages."""
        if not self.fast:
            return super().forward(tensordict)
        named = self.tensor_keys
        learned_from = (named.action, named.sample_log_prob, named.advantage, named.value_target)
        parts = self._of_rows(*(tensordict.get(key) for key in (keys.OBSERVATION, *learned_from)))
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
        """Returns the values of `REPORTED` and, with an entropy bonus, its loss.

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
        clip = self.clip_epsilon
        clipped = log_ratio.clamp((-clip).log1p(), clip.log1p())
        scaled = _standardised(advantage)
        gain = torch.minimum(log_ratio.exp() * scaled, clipped.exp() * scaled)
        critic: Any = self.critic_network
        miss = torch.nn.functional.mse_loss(critic.module(observation), target)
        found = (
            -gain.mean(),
            self.critic_coeff * miss,
            -log_ratio.detach().mean(),
            (clipped.detach() != log_ratio.detach()).float().mean(),
        )
        if self.entropy_bonus:
            found = (*found, -self.entropy_coeff * drawn.entropy().mean())
        return found


def _standardised(advantage: Tensor) -> Tensor:
    if advantage.numel() == 1:  # has no standard deviation; TorchRL leaves it as it is, too
        return advantage
    sd, mean = torch.std_mean(advantage)
    return (advantage - mean) / sd.clamp_min(SMALLEST_SD)


LOSSES: dict[str, type[LossModule]] = {"clip": ClippedLoss, "kl": KLPENPPOLoss, "a2c": A2CLoss}


def make_loss(policy: Policy, config: PPOConfig) -> LossModule:
    """The loss of a training.

    Our own actor is handed to `clip` as it is, and to every other loss as TorchRL's.

    Raises:
        ValueError: There is no such loss, it does not use a setting or an option that is given, or
            it cannot be compiled.
    """
    kind = loss_class(config.loss)
    arguments = _arguments(config, kind)
    actor = policy.actor() if kind is ClippedLoss else policy.torchrl_actor()
    if kind is ClippedLoss and compiles(config) and type(actor) is Actor:
        arguments["compiled"] = True
    elif config.compiled == "always":
        raise ValueError("ppo.compiled=always is for ppo.loss=clip and the package's own actor")
    try:
        return kind(actor, policy.critic(), **arguments)
    except (TypeError, AttributeError, KeyError, RuntimeError) as error:
        raise ValueError(f"ppo.loss={config.loss}: {one_line(error)}") from error


def loss_class(name: str) -> type[LossModule]:
    """The class of a loss.

    Args:
        name: In `LOSSES`, or one's own as file.py:Class or package.module:Class.

    Raises:
        ValueError: There is no such loss, or it is no `LossModule`.
    """
    if name in LOSSES:
        return LOSSES[name]
    if ":" not in name:
        raise ValueError(
            f"no loss {name!r}; available: {', '.join(LOSSES)}, or your own as file.py:Class"
        )
    found = load_named(name)
    trust.refuse_other_class(found, LossModule, name)
    return found


def _arguments(config: PPOConfig, kind: type[LossModule]) -> dict[str, Any]:
    """What a loss is given: those of our settings that it takes, and its options."""
    takes = _takes(kind)
    given = {**FIXED, **{argument: getattr(config, name) for name, argument in SETTINGS.items()}}
    given |= {"entropy_bonus": config.entropy_weight > 0}
    for name, argument in SETTINGS.items():
        value = getattr(config, name)
        if argument not in takes and value != getattr(PPOConfig, name):
            raise ValueError(
                f"ppo.{name}={value:g} is not used by ppo.loss={config.loss}: leave it out"
            )
    unknown = sorted(set(config.loss_options) - (takes - set(given)))
    if unknown:
        raise ValueError(
            f"ppo.loss_options: ppo.loss={config.loss} takes no {', '.join(unknown)}; available: "
            f"{', '.join(sorted(takes - set(given)))}"
        )
    if not config.entropy_weight:  # TorchRL takes no 0 where there is no bonus
        del given["entropy_coeff"]
    return {name: value for name, value in given.items() if name in takes} | config.loss_options


def _takes(kind: type[LossModule]) -> set[str]:
    """Names of the arguments of a class and of those that it is derived from, beside its networks.

    TorchRL's losses swallow arguments that they do not know.
    """
    found: set[str] = set()
    for cls in kind.__mro__:
        if "__init__" in vars(cls) and issubclass(cls, LossModule):
            found |= set(inspect.signature(cls.__init__).parameters)
    return found - {"self", "args", "kwargs", "options", "actor", "critic", "compiled"} - {
        "actor_network", "critic_network",
    }  # fmt: skip
