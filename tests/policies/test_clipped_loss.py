import shutil

import pytest
import torch
from tensordict import TensorDict
from torchrl.objectives import ClipPPOLoss

from buggy_rl.policies.training.actor_critic import Policy
from buggy_rl.policies.training.ppo import ClippedLoss, PPOConfig, compiles

NAMES = ("loss_objective", "loss_critic", "kl_approx", "clip_fraction")


def losses(kind, policy, entropy, **options):
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
        **options,
    )


def rows_of(policy, count):
    rows = policy.actor()(TensorDict({"observation": torch.randn(count, 23)}, [count])).detach()
    rows["action_log_prob"] += 0.3 * torch.randn(count)  # as of an older policy: some are clipped
    rows["advantage"], rows["value_target"] = 5 * torch.randn(count, 1) + 1, torch.randn(count, 1)
    return rows


@pytest.mark.parametrize("count", [1, 300])
@pytest.mark.parametrize("entropy", [False, True])
def test_losses_and_gradients_are_those_of_torchrl(entropy, count):
    torch.manual_seed(0)
    policy = Policy(23)
    rows = rows_of(policy, count)
    names = (*NAMES, "loss_entropy") if entropy else NAMES
    found = {}
    for kind in (ClipPPOLoss, ClippedLoss):
        loss = losses(kind, policy, entropy)(rows)
        total = sum(loss[name] for name in names if name.startswith("loss"))
        gradients = torch.autograd.grad(total, list(policy.parameters()))
        found[kind] = [*(loss[name].detach() for name in names), *gradients]
    assert count == 1 or 0.05 < found[ClippedLoss][3] < 0.95
    for one, other in zip(*found.values(), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-6)


@pytest.mark.skipif(shutil.which("g++") is None, reason="no C++ compiler here")
@pytest.mark.slow
def test_compiled_it_is_the_same_to_rounding():
    torch.manual_seed(0)
    policy = Policy(23)
    rows = rows_of(policy, 64)
    found = []
    for compiled in (False, True):
        loss = losses(ClippedLoss, policy, True, compiled=compiled)(rows)
        total = sum(loss[name] for name in (*NAMES[:2], "loss_entropy"))
        gradients = torch.autograd.grad(total, list(policy.parameters()))
        found.append([*(loss[name].detach() for name in NAMES), *gradients])
    for one, other in zip(*found, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-6)


def test_only_a_long_training_is_compiled_unless_it_is_said(monkeypatch):
    assert not compiles(PPOConfig(steps=1000))
    assert not compiles(PPOConfig(compiled="never"))
    monkeypatch.setattr(shutil, "which", lambda name: "/usr/bin/" + name)
    assert compiles(PPOConfig())
    assert compiles(PPOConfig(steps=1000, compiled="always"))
    monkeypatch.setattr(shutil, "which", lambda name: None)
    assert not compiles(PPOConfig())
    with pytest.raises(ValueError, match="install g"):
        compiles(PPOConfig(compiled="always"))
