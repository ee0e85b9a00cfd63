"""TorchRL's `ClipPPOLoss` without the diagnostics that are not logged."""

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.objectives import ClipPPOLoss

from buggy_rl import keys

SMALLEST_SD = 1e-4  # of an advantage, as in TorchRL


class ClippedLoss(ClipPPOLoss):
    """L = -mean min(r A, clip(r, 1 - eps, 1 + eps) A) + c_v mean (V - R)^2 - c_e mean H.

    r = pi(a|s) / pi_old(a|s), A the advantages of the minibatch less their mean and over their
    standard deviation. The same numbers and gradients as `ClipPPOLoss` with `functional=False`,
    `loss_critic_type="l2"` and `normalize_advantage=True`, which are fixed. Left out are effective
    sample size, extremes of r, and copies of TensorDicts.
    """

    clip_epsilon: Tensor
    critic_coeff: Tensor
    entropy_coeff: Tensor

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Losses and what is reported of them, for rows [N] with their advantages."""
        drawn = self.actor_network.get_dist(tensordict)
        log_prob = drawn.log_prob(tensordict.get(keys.ACTION))
        log_ratio = (log_prob - tensordict.get("action_log_prob")).unsqueeze(-1)  # (N, 1)
        low, high = (-self.clip_epsilon).log1p(), self.clip_epsilon.log1p()
        clipped = log_ratio.clamp(low.item(), high.item())
        advantage = _standardised(tensordict.get("advantage"))
        gain = torch.minimum(log_ratio.exp() * advantage, clipped.exp() * advantage)
        value = self.critic_network.module(tensordict.get(keys.OBSERVATION))
        miss = torch.nn.functional.mse_loss(value, tensordict.get("value_target"))
        found = {
            "loss_objective": -gain.mean(),
            "loss_critic": self.critic_coeff * miss,
            "kl_approx": -log_ratio.detach().mean(),
            "clip_fraction": (clipped.detach() != log_ratio.detach()).float().mean(),
        }
        if self.entropy_bonus:
            found["loss_entropy"] = -self.entropy_coeff * drawn.entropy().mean()
        return TensorDict(found)


def _standardised(advantage: Tensor) -> Tensor:
    sd, mean = torch.std_mean(advantage)
    return (advantage - mean) / sd.clamp_min(SMALLEST_SD)
