import shutil

import pytest
import torch
from tensordict import TensorDict
from torchrl.modules import ValueOperator
from torchrl.objectives import ClipPPOLoss

from buggy_rl.policies.training.actor_critic import Actor, Policy
from buggy_rl.policies.training.losses import FIXED, ClippedLoss, compiles
from buggy_rl.policies.training.ppo_config import PPOConfig

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


class Sharper(Actor):
    """An actor of one's own that is ours but for its distribution."""

    def get_dist(self, tensordict):
        drawn = super().get_dist(tensordict)
        return type(drawn)(drawn.loc, drawn.log_sd - 1.0)


class Doubled(ClippedLoss):
    def loss_critic(self, tensordict):
        value, *rest = super().loss_critic(tensordict)
        return (2 * value, *rest)


def overridden_actor(policy):
    own = policy.actor()
    return Sharper(own.mean, own.log_sd), policy.critic()


def patched_actor(policy):
    actor = policy.actor()
    actor.get_dist = Sharper(actor.mean, actor.log_sd).get_dist
    return actor, policy.critic()


def torchrl_actor(policy):
    return policy.torchrl_actor(), policy.critic()


class Critic(ValueOperator):
    def forward(self, tensordict):
        return tensordict.set("state_value", super().forward(tensordict)["state_value"] + 1)


def overridden_critic(policy):
    return policy.actor(), Critic(policy.critic().module, ["observation"])


FOREIGN = [overridden_actor, patched_actor, torchrl_actor, overridden_critic]


@pytest.mark.parametrize("networks", FOREIGN)
def test_any_network_but_ours_goes_through_the_forward_of_torchrl(networks):
    torch.manual_seed(0)
    policy = Policy(23)
    actor, critic = networks(policy)
    rows = rows_of(policy, 50)
    options = FIXED | {"clip_epsilon": 0.2, "critic_coeff": 0.7, "entropy_bonus": False}
    ours, theirs = (kind(actor, critic, **options) for kind in (ClippedLoss, ClipPPOLoss))
    assert not ours.fast
    found, expected = ours(rows), theirs(rows)
    assert set(found.keys()) == set(expected.keys())
    for name in NAMES:
        torch.testing.assert_close(found[name], expected[name])
    plain = ClippedLoss(policy.actor(), policy.critic(), **options)
    assert plain.fast
    if networks is not torchrl_actor:  # that one is the same distribution
        assert any(not torch.allclose(plain(rows)[name], found[name]) for name in NAMES)


@pytest.mark.parametrize(
    "options",
    [{"loss_critic_type": "smooth_l1"}, {"normalize_advantage": False}, {"clip_value": 0.1}],
)
def test_any_argument_but_ours_goes_through_the_forward_of_torchrl(options):
    torch.manual_seed(0)
    policy = Policy(23)
    rows = policy.critic()(rows_of(policy, 50)).detach()
    given = FIXED | {"clip_epsilon": 0.2, "critic_coeff": 0.7} | options
    ours, theirs = (
        kind(policy.actor(), policy.critic(), **given)(rows) for kind in (ClippedLoss, ClipPPOLoss)
    )
    for name in NAMES:
        torch.testing.assert_close(ours[name], theirs[name])


def test_a_loss_that_overrides_a_part_of_ours_is_asked_for_it():
    torch.manual_seed(0)
    policy = Policy(23)
    rows = rows_of(policy, 50)
    options = FIXED | {"clip_epsilon": 0.2, "critic_coeff": 0.7}
    plain, doubled = (
        kind(policy.actor(), policy.critic(), **options)(rows) for kind in (ClippedLoss, Doubled)
    )
    torch.testing.assert_close(doubled["loss_critic"], 2 * plain["loss_critic"])


def test_a_clipping_that_is_scheduled_is_followed():
    torch.manual_seed(0)
    policy = Policy(23)
    rows = rows_of(policy, 50)
    loss = losses(ClippedLoss, policy, False)
    before = loss(rows)["clip_fraction"]
    loss.clip_epsilon.fill_(0.95)
    assert loss(rows)["clip_fraction"] < 0.1 * before


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
