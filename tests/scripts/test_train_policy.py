"""The script that trains a policy, run as a user runs it, on a small circle."""

import runpy
import subprocess
import sys

import pandas as pd
import pytest
import torch
import yaml

from buggy_rl.policies.training.actor_critic import load_policy

SMALL = (
    "engine.simulator=kinematic", "task.paths.kind=circle", "ppo.cars=8", "ppo.batch_steps=16",
    "ppo.minibatch=64", "ppo.schedule=constant", "validation_steps=20", "checkpoint_batches=1",
    "policy.hidden=[8]",
)  # fmt: skip
BATCH = 128


@pytest.fixture
def train(monkeypatch, repository):
    """Runs the script in this process with the given arguments, from the root of the project."""

    def run(*arguments):
        monkeypatch.chdir(repository)
        monkeypatch.setattr(sys, "argv", ["scripts/train_policy.py", *SMALL, *arguments])
        runpy.run_path("scripts/train_policy.py", run_name="__main__")

    return run


def logged(folder, name):
    table = pd.read_csv(folder / "csv" / "scalars" / f"{name}.csv", header=None)
    return dict(zip(table[0], table[1], strict=True))


def test_a_run_leaves_policies_logs_and_what_made_them(train, tmp_path, capsys):
    train(f"output={tmp_path}", f"ppo.steps={4 * BATCH}", "validations=2")
    assert "waypoints on the selection paths" in capsys.readouterr().out
    policy, about = load_policy(tmp_path / "best.pt")
    assert policy.config.hidden == [8]
    assert about["config"]["engine"]["simulator"] == "kinematic"
    assert load_policy(tmp_path / "last.pt")[1]["steps"] == 4 * BATCH
    assert yaml.safe_load((tmp_path / "config.yaml").read_text())["ppo"]["cars"] == 8
    assert list(logged(tmp_path, "reward")) == [BATCH, 2 * BATCH, 3 * BATCH, 4 * BATCH]
    assert list(logged(tmp_path, "validation_waypoints")) == [2 * BATCH, 4 * BATCH]
    assert list((tmp_path / "tensorboard").glob("events.*"))
    assert not list(tmp_path.glob("*.partial"))


def test_the_best_policy_is_chosen_by_the_selection_paths(train, tmp_path, monkeypatch):
    told = iter([(3.0, 1.0), (5.0, 2.0), (4.0, 9.0)])  # selection, validation

    def validate(env, policy, steps):
        assert env.batch_size.numel() == 2  # the circle as each
        selection, validation = next(told)
        return {"selection_waypoints": selection, "validation_waypoints": validation}

    monkeypatch.setattr("buggy_rl.policies.training.run.validate", validate)
    train(f"output={tmp_path}", f"ppo.steps={3 * BATCH}", "validations=3")
    about = load_policy(tmp_path / "best.pt")[1]
    assert (about["selection_waypoints"], about["validation_waypoints"]) == (5.0, 2.0)


def test_a_resumed_run_writes_the_log_of_one_that_never_stopped(train, tmp_path):
    whole, halves = tmp_path / "whole", tmp_path / "halves"
    train(f"output={whole}", f"ppo.steps={4 * BATCH}", "validations=4")
    train(f"output={halves}", f"ppo.steps={2 * BATCH}", "validations=2")
    train(f"output={halves}", f"ppo.steps={4 * BATCH}", "validations=4", "resume=true")
    for name in ("reward", "loss_objective", "kl_approx", "validation_waypoints", "sd_throttle"):
        assert logged(whole, name) == logged(halves, name), name
    one, other = (load_policy(folder / "last.pt")[0].state_dict() for folder in (whole, halves))
    assert all(torch.equal(one[name], other[name]) for name in one)


OWN = """
from buggy_rl.simulators.bicycle.single_track import KinematicEngine
from helper import DELAY


def make(batch_size, device):
    return KinematicEngine(batch_size, device)
"""


@pytest.fixture
def simulator(tmp_path, monkeypatch):
    """A user's own, of two files."""
    (tmp_path / "mine.py").write_text(OWN)
    (tmp_path / "helper.py").write_text("DELAY = 1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    yield f"engine.simulator={tmp_path}/mine.py:make"
    sys.modules.pop("helper", None)


def test_a_run_is_not_resumed_with_another_question(train, tmp_path, simulator):
    output = f"output={tmp_path / 'run'}"
    train(output, simulator, f"ppo.steps={BATCH}", "validations=1")
    files = {file: file.read_bytes() for file in (tmp_path / "run").rglob("*") if file.is_file()}
    longer = (output, simulator, f"ppo.steps={2 * BATCH}", "validations=1", "resume=true")
    for more, said in {
        "engine.simulator=kinematic": "engine.simulator was mine.py:make, now kinematic",
        "ppo.learning_rate=0.1": "ppo.learning_rate was 0.003, now 0.1",
        "seed=7": "seed was 0, now 7",
        "ppo.schedule=linear": "ppo.schedule was constant, now linear",
        "task.transforms.command.name=rate_limit": "task.transforms.command.name was none, now ra",
    }.items():
        with pytest.raises(SystemExit, match=f"checkpoint.pt answers another question: .*{said}"):
            train(*longer, more)
    (tmp_path / "helper.py").write_text("DELAY = 2\n")
    with pytest.raises(SystemExit, match=r"helper\.py has other content now; resume with the set"):
        train(*longer)
    # Nothing in the folder has changed: what is there belongs together.
    assert files == {file: file.read_bytes() for file in files}
    (tmp_path / "helper.py").write_text("DELAY = 1\n")
    train(*longer, "threads=1")
    assert load_policy(tmp_path / "run" / "last.pt")[1]["steps"] == 2 * BATCH


def test_a_training_made_longer_at_a_falling_rate_says_so(train, tmp_path, capsys):
    train(f"output={tmp_path}", f"ppo.steps={BATCH}", "ppo.schedule=linear")
    train(f"output={tmp_path}", f"ppo.steps={2 * BATCH}", "ppo.schedule=linear", "resume=true")
    assert f"note: begun with ppo.steps={BATCH}, now {2 * BATCH}" in capsys.readouterr().out


def test_a_run_that_ends_before_its_first_policy_leaves_the_one_that_is_there(train, tmp_path):
    train(f"output={tmp_path}", f"ppo.steps={BATCH}", "validations=1")
    kept = {name: (tmp_path / name).read_bytes() for name in ("best.pt", "config.yaml", "run.json")}
    with pytest.raises(SystemExit, match="loss is nan"):
        train(f"output={tmp_path}", f"ppo.steps={8 * BATCH}", "validations=1",
              "ppo.learning_rate=1e38")  # fmt: skip
    assert kept == {name: (tmp_path / name).read_bytes() for name in kept}
    train(f"output={tmp_path}", f"ppo.steps={BATCH}", "validations=1", "seed=5")
    assert yaml.safe_load((tmp_path / "config.yaml").read_text())["seed"] == 5
    assert load_policy(tmp_path / "best.pt")[1]["config"]["seed"] == 5


def test_files_of_the_users_own_in_the_output_are_left_alone(train, tmp_path):
    (tmp_path / "csv").mkdir()
    (tmp_path / "csv" / "laps.csv").write_text("1,2\n")
    for _ in range(2):
        train(f"output={tmp_path}", f"ppo.steps={BATCH}", "validations=1")
    assert (tmp_path / "csv" / "laps.csv").read_text() == "1,2\n"
    assert list(logged(tmp_path, "reward")) == [BATCH]


def test_there_must_be_something_to_resume(train, tmp_path):
    with pytest.raises(SystemExit, match="no checkpoint"):
        train(f"output={tmp_path}", "resume=true")


def test_a_loss_that_is_no_number_leaves_its_batch_behind(train, tmp_path):
    with pytest.raises(SystemExit, match=r"loss is nan after \d+ steps[^\n]*\n.*failed_batch\.pt"):
        train(f"output={tmp_path}", f"ppo.steps={8 * BATCH}", "ppo.learning_rate=1e38")
    assert set(torch.load(tmp_path / "failed_batch.pt")) >= {"observation", "action", "advantage"}


def test_the_row_of_the_loss_that_is_no_number_reaches_the_log(train, tmp_path):
    with pytest.raises(SystemExit, match="loss is nan"):
        train(f"output={tmp_path}", f"ppo.steps={8 * BATCH}", "ppo.learning_rate=1e38",
              "checkpoint_batches=100")  # fmt: skip
    losses = logged(tmp_path, "loss_objective")
    assert list(losses) == [BATCH * (row + 1) for row in range(len(losses))]
    assert pd.isna(list(losses.values())[-1])
    assert list(logged(tmp_path, "reward")) == list(losses)
    assert not (tmp_path / "checkpoint.pt").exists()


def test_weights_and_biases_are_told_on_request(train, tmp_path, monkeypatch):
    monkeypatch.setenv("WANDB_MODE", "disabled")
    train(f"output={tmp_path}", f"ppo.steps={BATCH}", "validations=1", "wandb=true")
    assert (tmp_path / "best.pt").is_file()


@pytest.mark.slow
def test_pictures_and_films_change_nothing_in_the_training(train, tmp_path):
    plain, shown = tmp_path / "plain", tmp_path / "shown"
    options = f"ppo.steps={2 * BATCH}", "validations=1"
    train(f"output={plain}", *options)
    train(f"output={shown}", *options, "media=true")
    made = {file.name for file in (shown / "media").iterdir()}
    assert made == {f"trajectories_{2 * BATCH}.png", f"film_{2 * BATCH}.gif"}
    one, other = (load_policy(folder / "last.pt")[0].state_dict() for folder in (plain, shown))
    assert all(torch.equal(one[name], other[name]) for name in one)


def test_runs_on_two_simulators_differ_in_the_engine_alone(train, tmp_path):
    written = {}
    for name in ("kinematic", "single_track"):
        train(f"output={tmp_path}", f"ppo.steps={BATCH}", f"engine.simulator={name}")
        written[name] = yaml.safe_load((tmp_path / "config.yaml").read_text())
        assert written[name].pop("engine")["simulator"] == name
    assert written["kinematic"] == written["single_track"]


def test_help_answers_without_torch(repository):
    command = [sys.executable, "-X", "importtime", "scripts/train_policy.py", "--help"]
    done = subprocess.run(command, cwd=repository, capture_output=True, text=True, check=True)
    assert "ppo.learning_rate=0.003" in done.stdout
    assert "torch" not in done.stderr
