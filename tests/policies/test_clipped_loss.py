import pytest
import torch
from tensordict import TensorDict
from torchrl.objectives import ClipPPOLoss

from buggy_rl.policies.actor_critic import Policy
from buggy_rl.policies.clipped_loss import ClippedLoss

NAMES = ("loss_objective", "loss_critic", "kl_approx", "clip_fraction")


def losses(kind, policy, entropy):
    return kind(
        policy.actor(),
        policy.critic(),
        clip_epsilon=0.2,
        loss_critic_type="l2",
        critic_coeff=0.7,
        normalize_advantage=True,
        entropy_bonus=entropy,
        entropy_coeff=0.01 if entropy else None,
        functional=False,
    )


@pytest.mark.parametrize("entropy", [False, True])
def test_losses_and_gradients_are_those_of_torchrl(entropy):
    torch.manual_seed(0)
    policy = Policy(23)
    rows = policy.actor()(TensorDict({"observation": torch.randn(300, 23)}, [300])).detach()
    rows["action_log_prob"] += 0.3 * torch.randn(300)  # as of an older policy: some are clipped
    rows["advantage"], rows["value_target"] = 5 * torch.randn(300, 1) + 1, torch.randn(300, 1)
    names = (*NAMES, "loss_entropy") if entropy else NAMES
    found = {}
    for kind in (ClipPPOLoss, ClippedLoss):
        loss = losses(kind, policy, entropy)(rows)
        total = sum(loss[name] for name in names if name.startswith("loss"))
        gradients = torch.autograd.grad(total, list(policy.parameters()))
        found[kind] = [*(loss[name].detach() for name in names), *gradients]
    assert 0.05 < found[ClippedLoss][3] < 0.95
    for one, other in zip(*found.values(), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-6)
