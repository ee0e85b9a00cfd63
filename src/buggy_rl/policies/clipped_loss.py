"""TorchRL's `ClipPPOLoss` without the diagnostics that are not logged, compiled where asked for."""

import math
from collections.abc import Callable
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.objectives import ClipPPOLoss

from buggy_rl import keys

SMALLEST_SD = 1e-4  # of an advantage, as in TorchRL
LEARNED_FROM = (keys.OBSERVATION, keys.ACTION, "action_log_prob", "advantage", "value_target")
REPORTED = ("loss_objective", "loss_critic", "kl_approx", "clip_fraction")


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
    sd, mean = torch.std_mean(advantage)
    return (advantage - mean) / sd.clamp_min(SMALLEST_SD)
