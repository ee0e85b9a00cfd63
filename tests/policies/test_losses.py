"""Losses by name: which class, with which of our settings, and what is refused."""

import math

import pytest
import torch
from tensordict import TensorDict
from torchrl.objectives import A2CLoss, KLPENPPOLoss

from buggy_rl.core.config import build
from buggy_rl.core.files import save_torch
from buggy_rl.policies.training.actor_critic import Policy
from buggy_rl.policies.training.checkpoint import load_checkpoint
from buggy_rl.policies.training.losses import ClippedLoss, make_loss
from buggy_rl.policies.training.ppo import PPO
from buggy_rl.policies.training.ppo_config import PPOConfig
from buggy_rl.policies.training.run import PolicyRunConfig
from tests.policies.test_ppo import config, curve, point

OWN = """
import torch
from tensordict import TensorDict
from torch import nn
from torchrl.objectives import LossModule


class Imitation(LossModule):
    '''Nearness to a command that is learned, of actor and critic.'''

    def __init__(self, actor, critic, critic_coeff=1.0, sharpness=1.0):
        super().__init__()
        self.actor, self.critic, self.sharpness = [actor], [critic], sharpness
        self.target = nn.Parameter(torch.zeros(2))

    def forward(self, tensordict):
        mean = self.actor[0].get_dist(tensordict).mean
        assert ("next", "reward") in tensordict.keys(True)
        return TensorDict({"loss_far": self.sharpness * (mean - self.target - 1).square().mean()})


class NoLoss:
    pass
"""


@pytest.fixture
def own(tmp_path):
    file = tmp_path / "own.py"
    file.write_text(OWN)
    return f"{file}:Imitation"


@pytest.mark.parametrize(
    ("name", "kind"), [("clip", ClippedLoss), ("kl", KLPENPPOLoss), ("a2c", A2CLoss)]
)
def test_each_loss_trains_and_reports_what_is_finite(name, kind):
    torch.manual_seed(0)
    run = PPO(point(), Policy(1), config(loss=name, entropy_weight=0.01))
    assert type(run.loss) is kind
    before = run.policy.state_dict()["mean_layers.0.weight"].clone()
    rows = list(run.run())
    assert all(
        math.isfinite(rows[-1][n]) for n in ("loss_objective", "loss_critic", "loss_entropy")
    )
    assert ("clip_fraction" in rows[-1]) == (name == "clip")
    assert not torch.equal(before, run.policy.state_dict()["mean_layers.0.weight"])


def test_settings_reach_the_loss():
    loss = make_loss(
        Policy(1), PPOConfig(loss="kl", value_weight=0.7, loss_options={"dtarg": 0.05})
    )
    assert loss.critic_coeff == pytest.approx(0.7)
    assert loss.dtarg == 0.05
    assert loss.normalize_advantage
    assert not loss.entropy_bonus


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"loss": "cli"}, "no loss 'cli'; available: clip, kl, a2c, or your own"),
        ({"loss": "a2c", "clip": 0.3}, r"ppo\.clip=0\.3 is not used by ppo\.loss=a2c"),
        ({"loss": "kl", "clip": 0.3}, r"ppo\.clip=0\.3 is not used by ppo\.loss=kl"),
        ({"loss": "a2c", "loss_options": {"dtarg": 1.0}}, "ppo.loss=a2c takes no dtarg; available"),
        ({"loss": "kl", "loss_options": {"critic_coeff": 1.0}}, "takes no critic_coeff; available"),
        ({"loss": "kl", "compiled": "always"}, "ppo.compiled=always is for ppo.loss=clip"),
        ({"loss": "builtins:dict"}, "the class builtins.dict, expected a subclass of torchrl"),
    ],
)
def test_what_a_loss_cannot_use_is_refused_by_name(settings, said):
    with pytest.raises(ValueError, match=said):
        make_loss(Policy(1), PPOConfig(**settings))


def test_a_loss_of_ones_own_has_the_whole_batch_and_weights_that_are_trained(own):
    torch.manual_seed(0)
    run = PPO(point(), Policy(1), config(loss=own, loss_options={"sharpness": 2.0}))
    rows = list(run.run())
    assert rows[-1]["loss_far"] < rows[0]["loss_far"]
    assert run.loss.target.abs().max() > 0
    with pytest.raises(ValueError, match=r"ppo\.clip=0\.3 is not used"):
        make_loss(Policy(1), PPOConfig(loss=own, clip=0.3))


def test_a_resumed_run_has_the_weight_of_the_penalty_that_it_had_come_to(tmp_path):
    torch.manual_seed(1)
    whole = PPO(point(), Policy(1), config(loss="kl", learning_rate=3e-2))
    rows = []
    for metrics in whole.run():
        rows.append(metrics)
        if len(rows) == 2:
            save_torch(tmp_path / "checkpoint.pt", whole.state_dict())
            beta = whole.loss.beta.clone()
    assert beta != 1.0
    again = PPO(point(), Policy(1), config(loss="kl", learning_rate=3e-2))
    again.load_state_dict(load_checkpoint(tmp_path / "checkpoint.pt"))
    assert again.loss.beta == beta
    assert curve(again.run()) == curve(rows[2:])


def test_torchrl_s_actor_is_ours_with_other_methods():
    torch.manual_seed(0)
    policy, observation = Policy(5), torch.randn(20, 5)
    rows = policy.actor()(TensorDict({"observation": observation}, [20]))
    drawn = policy.torchrl_actor().get_dist(rows)
    torch.testing.assert_close(drawn.log_prob(rows["action"]), rows["action_log_prob"])
    one, other = (
        torch.autograd.grad(value.sum(), list(policy.parameters()), allow_unused=True)
        for value in (drawn.log_prob(rows["action"].detach()),
                      policy.actor().get_dist(rows).log_prob(rows["action"].detach()))
    )  # fmt: skip
    for mine, theirs in zip(one, other, strict=True):
        assert (mine is None) == (theirs is None)
        assert mine is None or torch.allclose(mine, theirs, atol=1e-5)


def test_options_of_a_loss_go_with_its_name():
    run = build(PolicyRunConfig, ["output=x", "ppo.loss=kl", "ppo.loss_options.dtarg=0.02"])
    assert run.ppo.loss_options == {"dtarg": 0.02}
