"""A user's own simulator through the script that trains a policy, as a user calls it."""

import runpy
import sys

import pytest
import yaml

from buggy_rl.policies.training.actor_critic import load_policy

SMALL = (
    "configs/ppo.yaml", "task.paths.kind=circle", "ppo.cars=8", "ppo.batch_steps=8",
    "ppo.minibatch=64", "ppo.steps=128", "validations=1", "validation_steps=10",
    "checkpoint_batches=1", "policy.hidden=[8]",
)  # fmt: skip


@pytest.fixture
def train(monkeypatch, repository):
    """Runs the script in this process, from the root of the project."""

    def run(*arguments):
        monkeypatch.chdir(repository)
        monkeypatch.setattr(sys, "argv", ["scripts/train_policy.py", *SMALL, *arguments])
        runpy.run_path("scripts/train_policy.py", run_name="__main__")

    return run


@pytest.mark.parametrize(
    "engine",
    [
        pytest.param(["engine.simulator=tests/plain_env.py:make"], marks=pytest.mark.slow),
        ["engine.simulator=tests/plain_env.py:make_declared", "engine.parameters.grip=0.6"],
    ],
    ids=["bare", "declared"],
)
def test_a_policy_is_trained_in_it_and_goes_on(train, engine, tmp_path):
    train(*engine, f"output={tmp_path}")
    train(*engine, f"output={tmp_path}", "resume=true", "ppo.steps=192")
    policy, about = load_policy(tmp_path / "last.pt")
    assert policy.config.hidden == [8]
    assert about["steps"] == 192
    assert about["config"]["engine"]["simulator"].startswith("tests/plain_env.py:make")


def test_another_task_does_not_go_on_from_its_checkpoint(train, tmp_path):
    engine = "engine.simulator=tests/plain_env.py:make"
    train(engine, f"output={tmp_path}")
    other = "task.transforms.command.name=rate_limit"
    with pytest.raises(SystemExit, match=r"command\.name was none, now rate_limit; resume with"):
        train(engine, f"output={tmp_path}", "resume=true", "ppo.steps=192", other)


def test_its_effects_come_along(train, tmp_path, repository):
    file = tmp_path / "repaired.yaml"
    content = {
        "engine": f"{repository / 'tests/plain_env.py'}:make",
        "effects": {"steering_dead_time": {"dead_time": 0.05}, "sensor_yaw": {"angle": 0.05}},
    }
    file.write_text(yaml.safe_dump(content))
    train("configs/ppo_car.yaml", f"engine.simulator={file}", f"output={tmp_path / 'run'}")
    assert (tmp_path / "run" / "best.pt").is_file()
