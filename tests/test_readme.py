"""What README and the walks of docs tell a newcomer to type, typed."""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from buggy_rl.core.config import build, plain_values
from buggy_rl.effects import EFFECTS, OF_A_COMMAND
from buggy_rl.policies.training.actor_critic import load_policy
from buggy_rl.policies.training.run import PolicyRunConfig
from buggy_rl.task.transforms.commands import RateLimit

ROOT = Path(__file__).parents[1]
FITTED = {
    "engine": "mujoco",
    "parameters": {"steering_lag": 0.03},
    "_fit": {"steering_lag": {"low": 0.02, "high": 0.04}},
}
README = (ROOT / "README.md").read_text()
POLICIES = (ROOT / "docs" / "policies.md").read_text()
SIMULATORS = (ROOT / "docs" / "simulators.md").read_text()
WALK = SIMULATORS.split("\n## From drives to a simulator\n")[1].split("\n## ")[0]


def blocks(text):
    """Language and code of each block that a test runs."""
    return re.findall(r"^```(bash|python)\n(.*?)^```", text, re.M | re.S)


BLOCKS = {"readme": blocks(README), "simulators": blocks(WALK)}


def test_the_readme_and_the_walk_have_commands_to_run():
    assert {language for language, _ in BLOCKS["readme"]} == {"bash"}
    assert {language for language, _ in BLOCKS["simulators"]} == {"bash", "python"}


def test_the_example_swaps_one_transform_in_five_lines(monkeypatch, capsys):
    (block,) = [b for _, b in blocks(POLICIES) if "transforms.command.name=none" in b]
    assert len([line for line in block.splitlines() if line]) == 5
    monkeypatch.chdir(ROOT)
    space: dict = {}
    exec(block, space)
    assert re.match(r"tensor\(-?\d+\.", capsys.readouterr().out)
    swapped = [type(t) for t in space["env"].transform]
    exec(block.replace(', "transforms.command.name=none"', ""), space)
    before = [type(t) for t in space["env"].transform]
    assert RateLimit in before
    assert swapped == [kind for kind in before if kind is not RateLimit]


def test_every_effect_of_the_library_is_in_the_table_and_no_count_of_them_ages():
    rows = re.findall(r"^\| `(\w+)` \|", README, re.M)
    assert sorted(rows) == sorted([*EFFECTS, *OF_A_COMMAND])
    method = (ROOT / "docs" / "effects.md").read_text()
    assert set(EFFECTS) <= set(re.findall(r"^\| `(\w+)` \|", method, re.M))
    assert not re.search(r"\b\d+ effects\b", README)


def test_the_two_trainings_differ_in_the_engine_alone(monkeypatch):
    monkeypatch.chdir(ROOT)
    lines = POLICIES.replace("\\\n", " ").splitlines()
    commands = [shlex.split(line) for line in lines if "scripts/train_policy.py" in line]
    learned, mujoco = (plain_values(build(PolicyRunConfig, words[2:])) for words in commands[:2])
    assert {Path(c["engine"]["simulator"]).suffix for c in (learned, mujoco)} == {".pt", ".yaml"}
    for config in (learned, mujoco):
        del config["engine"], config["output"]
    assert learned == mujoco
    assert learned["task"]["transforms"]["rewards"]["options"]  # ours, not the bare defaults


@pytest.mark.slow
def test_a_policy_for_a_car_trains_in_cars_that_differ(tmp_path: Path):
    (block,) = [
        b for b in re.findall(r"^```sh\n(.*?)^```", POLICIES, re.M | re.S) if "cars.py" in b
    ]
    for part in ("scripts", "configs"):
        shutil.copytree(ROOT / part, tmp_path / part)
    fitted = tmp_path / "runs" / "my_car" / "mujoco_fitted.yaml"
    fitted.parent.mkdir(parents=True)
    fitted.write_text(yaml.safe_dump(FITTED))
    small = (
        " ppo.steps=128 ppo.cars=8 ppo.batch_steps=16 ppo.minibatch=64"
        " validation_steps=20 validations=1"
    )
    path = f"{Path(sys.executable).parent}:/usr/bin:/bin"
    environment = {"PATH": path, "OMP_NUM_THREADS": "1", "HOME": str(tmp_path)}
    command = ["bash", "-ec", block.rstrip() + small]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    _, about = load_policy(fitted.parent / "policy_robust" / "best.pt")
    task = about["config"]["task"]["transforms"]
    assert task["noise"]["name"] == "observation_noise"
    assert "last_action" in task["observation"]["options"]["inputs"]


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("page", BLOCKS)
def test_every_command_of_a_page_runs_in_the_order_given(page: str, tmp_path: Path):
    clone = tmp_path / "clone"
    parts = ("scripts", "configs", "data/sample", "src")
    for part in parts:
        shutil.copytree(ROOT / part, clone / part)
    path = f"{Path(sys.executable).parent}:/usr/bin:/bin"
    environment = {"PATH": path, "OMP_NUM_THREADS": "1", "HOME": str(tmp_path)}
    for language, block in BLOCKS[page]:
        command = ["bash", "-ec", block] if language == "bash" else [sys.executable, "-c", block]
        done = subprocess.run(
            command,
            cwd=clone,
            env=environment,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, f"{block}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
