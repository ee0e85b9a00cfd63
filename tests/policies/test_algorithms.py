"""A second algorithm beside PPO: chosen by its name, in the same run."""

from dataclasses import dataclass, field, replace
from typing import Any

import pytest
import torch

from buggy_rl.api.training import policy_metrics
from buggy_rl.core.config import build
from buggy_rl.policies.training import run as run_module
from buggy_rl.policies.training.actor_critic import load_policy
from buggy_rl.policies.training.ppo import PPO
from buggy_rl.policies.training.run import PolicyRun, PolicyRunConfig, policy_question

SMALL = (
    "engine.simulator=kinematic", "task.paths.kind=circle", "policy.hidden=[8]", "validations=2",
    "validation_steps=5", "checkpoint_batches=1",
)  # fmt: skip


@dataclass(frozen=True)
class CountConfig:
    """Settings of `Count`."""

    steps: int = 40
    cars: int = 2
    batch: int = 10
    seed: int = 0


class Count:
    """Adds 1 to the first weight of the policy in every batch."""

    def __init__(self, env, policy, config, batches):
        assert env.batch_size == (config.cars,)
        assert batches is None
        self.policy, self.config, self.steps = policy, config, 0

    def run(self):
        while self.steps < self.config.steps:
            with torch.no_grad():
                next(self.policy.parameters()).flatten()[0] += 1
            self.steps += self.config.batch
            yield {"steps": self.steps, "reward": 0.0, "waypoints": 0.0, "speed": 1.0}

    def state_dict(self):
        return {"steps": self.steps, "policy": self.policy.state_dict()}

    def load_state_dict(self, state):
        self.steps = state["steps"]
        self.policy.load_state_dict(state["policy"])


@dataclass(frozen=True)
class TwoAlgorithms(PolicyRunConfig):
    """A config with a second block of settings."""

    algorithm: Any = "ppo"
    count: CountConfig = field(default_factory=CountConfig)


@pytest.fixture
def two(monkeypatch):
    monkeypatch.setitem(run_module.ALGORITHMS, "count", Count)
    return TwoAlgorithms


def first_weight(file):
    return next(load_policy(file)[0].parameters()).flatten()[0].item()


def test_a_second_algorithm_has_the_validations_the_log_and_the_checkpoint_of_the_first(
    two, tmp_path
):
    options = [*SMALL, f"output={tmp_path}", "algorithm=count"]
    config = build(two, options)
    run = PolicyRun(config)
    begun = next(run.policy.parameters()).flatten()[0].item()
    rows = list(policy_metrics(run))
    assert [row["steps"] for row in rows] == [10, 20, 30, 40]
    assert ["validation_waypoints" in row for row in rows] == [False, True, False, True]
    assert first_weight(tmp_path / "last.pt") == pytest.approx(begun + 4)
    assert len((tmp_path / "csv" / "scalars" / "reward.csv").read_text().splitlines()) == 4
    longer = replace(config, resume=True, count=CountConfig(steps=60))
    assert [row["steps"] for row in policy_metrics(PolicyRun(longer))] == [50, 60]
    assert first_weight(tmp_path / "last.pt") == pytest.approx(begun + 6)
    other = replace(config, resume=True, count=CountConfig(seed=1))
    with pytest.raises(ValueError, match=r"count\.seed was 0, now 1"):
        PolicyRun(other)


def test_settings_of_an_algorithm_that_does_not_train_are_no_part_of_the_question(two):
    old = policy_question(build(PolicyRunConfig, [*SMALL, "output=x"]))
    assert policy_question(build(two, [*SMALL, "output=x", "count.seed=3"])) == old
    asked = policy_question(build(two, [*SMALL, "output=x", "algorithm=count"]))
    assert asked["algorithm"] == "count"
    assert not [name for name in asked if name.startswith("ppo.")]


def test_ppo_is_the_algorithm_unless_another_is_named(tmp_path):
    small = ("ppo.cars=4", "ppo.batch_steps=4", "ppo.steps=16")
    run = PolicyRun(build(PolicyRunConfig, [*SMALL, *small, f"output={tmp_path}"]))
    assert isinstance(run.trainer, PPO)
    assert run.batch == 16
    with pytest.raises(ValueError, match="algorithm"):
        build(PolicyRunConfig, ["output=x", "algorithm=sac"])


def test_a_training_begins_with_the_weights_of_a_policy_file(two, tmp_path):
    first = build(two, [*SMALL, f"output={tmp_path / 'first'}", "algorithm=count"])
    list(policy_metrics(PolicyRun(first)))
    file = tmp_path / "first" / "last.pt"
    more = build(two, [*SMALL, f"output={tmp_path / 'more'}", "algorithm=count", f"start={file}"])
    run = PolicyRun(more)
    assert all(weight.requires_grad for weight in run.policy.parameters())
    list(policy_metrics(run))
    assert first_weight(tmp_path / "more" / "last.pt") == first_weight(file) + 4
    asked = policy_question(more)
    assert asked["start"] == "last.pt"
    assert "start" not in policy_question(first)


def test_a_policy_of_another_observation_is_no_start(two, tmp_path):
    first = build(two, [*SMALL, f"output={tmp_path / 'first'}", "algorithm=count"])
    list(policy_metrics(PolicyRun(first)))
    other = [*SMALL, "task.transforms.history.name=history", f"output={tmp_path / 'more'}"]
    more = build(two, [*other, f"start={tmp_path / 'first' / 'last.pt'}"])
    with pytest.raises(ValueError, match="takes observations of 23 numbers, the task has 92"):
        PolicyRun(more)
