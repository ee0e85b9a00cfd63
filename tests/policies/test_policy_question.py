"""What a training is: settings that came later leave the questions of old checkpoints valid."""

import pytest

from buggy_rl.core.config import build
from buggy_rl.policies.training.run import LATER, PolicyRunConfig, policy_question


def asked(*options):
    return policy_question(build(PolicyRunConfig, ["output=x", *options]))


def test_a_setting_that_came_later_is_named_only_where_it_is_used():
    assert not set(asked()) & set(LATER)
    assert asked("ppo.loss=kl") == {**asked(), "ppo.loss": "kl"}


@pytest.mark.parametrize(
    "option", ["ppo.loss=kl", "ppo.loss_options.clip_value=0.1", "ppo.clip=0.3"]
)
def test_another_loss_is_another_question(option):
    assert asked(option) != asked()
