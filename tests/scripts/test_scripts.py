"""The scripts as a user runs them, on a small study; one after the other in one folder."""

import runpy
import sys
from pathlib import Path

import pandas as pd
import pytest
import yaml

from buggy_rl.policies.training.seeds import read_log
from tests.running import Done, run_script

ROOT = Path(__file__).parents[2]
STUDY = """
data:
  recordings: [data/sample/sample_00.csv, data/sample/sample_01.csv, data/sample/sample_02.csv]
  held_out: [sample_02]
  validation: [sample_01]
windows: 20
fit: {windows: 8, iterations: 2, parameters: [mass, drive_force]}
fit_simulator: single_track
runs:
  MLP: {training: {loss: one_step, epochs: 2}, preparations: [raw, mirrored]}
"""


def run(script: str, *arguments: str) -> Done:
    return run_script(f"scripts/{script}.py", *arguments)


@pytest.fixture(scope="module")
def study(tmp_path_factory) -> list[str]:
    folder = tmp_path_factory.mktemp("study")
    (folder / "study.yaml").write_text(STUDY)
    return [str(folder / "study.yaml"), f"output={folder / 'out'}"]


@pytest.fixture(scope="module")
def finished(study: list[str]) -> Path:
    for script in ("train_models", "fit_mujoco", "evaluate_models"):
        done = run(script, *study)
        assert done.returncode == 0, done.stderr
    return Path(study[1].removeprefix("output="))


def test_training_fitting_and_comparing_leave_models_a_fit_and_a_table(finished: Path):
    table = pd.read_csv(finished / "table.csv")
    assert {"MLP, raw", "MLP, mirrored", "hold last", "single_track, fitted"} <= set(
        table["simulator"]
    )
    assert (table["low"] <= table["position_mse_1s"]).all()
    assert (table["position_mse_1s"] <= table["high"]).all()
    for picture in ("table.png", "rollouts.png"):
        assert (finished / picture).read_bytes().startswith(b"\x89PNG")


def test_a_fit_is_a_simulator_file_with_intervals(finished: Path):
    content = yaml.safe_load((finished / "single_track_fitted.yaml").read_text())
    assert set(content["parameters"]) == {"mass", "drive_force"}
    about = content["_fit"]["drive_force"]
    assert about["low"] <= content["parameters"]["drive_force"] <= about["high"]


def test_training_leaves_a_log_of_each_model(finished: Path):
    folder = finished / "models" / "mlp__raw"
    losses = read_log(folder, "validation_loss")
    assert list(losses.index) == [1, 2]
    assert yaml.safe_load((folder / "config.yaml").read_text())["model"]["kind"] == "mlp"
    assert list((folder / "tensorboard").glob("events.*"))


def test_models_are_compared_by_their_logs(finished: Path, tmp_path: Path):
    done = run("compare", f"sweep={finished / 'models'}", "metrics=[validation_loss]",
               f"output={tmp_path}")  # fmt: skip
    assert done.returncode == 0, done.stderr
    table = pd.read_csv(tmp_path / "table.csv")
    groups = {"training.preparation=raw", "training.preparation=mirrored"}
    assert set(table["group"]) == groups
    assert (tmp_path / "curves.png").is_file()


def test_every_run_says_how_it_was_made(finished: Path):
    config = yaml.safe_load((finished / "models" / "config.yaml").read_text())
    assert config["runs"]["MLP"]["training"]["epochs"] == 2
    assert "train_models.py" in (finished / "models" / "run.json").read_text()


def test_training_again_leaves_finished_models_alone(study: list[str], finished: Path):
    before = (finished / "models" / "mlp__raw.pt").read_bytes()
    done = run("train_models", *study)
    assert "is there already" in done.stdout
    assert (finished / "models" / "mlp__raw.pt").read_bytes() == before


def test_comparing_before_fitting_says_what_to_run(study: list[str], tmp_path: Path):
    done = run("evaluate_models", study[0], f"output={tmp_path}")
    assert done.returncode == 1
    assert "error: there is no model file" in done.stderr


def test_a_misspelt_option_is_one_line_not_a_traceback(study: list[str]):
    done = run("train_models", *study, "runs.MLP.training.epoch=3")
    assert done.returncode == 1
    assert "did you mean 'epochs'" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_missing_folder_of_drives_is_one_line_not_a_traceback(study: list[str]):
    done = run("train_models", *study, "data.recordings=[nowhere]")
    assert done.returncode == 1
    assert "nowhere" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.fixture
def run_here(monkeypatch):
    """Runs a script in this process; what it raises and prints is the test's."""

    def run_one(script: str, *arguments: str) -> None:
        monkeypatch.chdir(ROOT)
        monkeypatch.setattr(sys, "argv", [f"scripts/{script}.py", *arguments])
        runpy.run_path(f"scripts/{script}.py", run_name="__main__")

    return run_one


SMALL_TASK = ("task.paths.count=3", "task.paths.validation_count=2", "task.paths.waypoints=12")


@pytest.mark.parametrize(
    ("script", "arguments"),
    [
        ("train_policy", ["engine.simulator=nowhere.yaml"]),
        ("show_policies", ["policies.mine=nowhere.pt"]),
        ("show_paths", ["paths.kind=file", "paths.file=nowhere.csv"]),
    ],
)
def test_a_missing_file_is_one_line_not_a_traceback(run_here, tmp_path, script, arguments):
    with pytest.raises(SystemExit, match=r"^error: .*nowhere"):
        run_here(script, *arguments, f"output={tmp_path / 'made'}")


@pytest.fixture
def short_episodes(monkeypatch):
    """Benchmarks of 0.6 s in place of 10."""
    for name in ("STEPS", "RANDOM_STEPS"):
        monkeypatch.setattr(f"buggy_rl.policies.evaluation.drives.{name}", 60)


@pytest.mark.slow
@pytest.mark.usefixtures("short_episodes")
def test_tuned_drivers_a_policy_and_their_pictures(run_here, tmp_path: Path, capsys):
    engine = "engine.simulator=kinematic"
    small = ("rounds=1", "candidates=4", "tuning_paths=2", "steps=60", "random_paths=2")
    run_here("tune_drivers", engine, f"output={tmp_path / 'drivers'}", *SMALL_TASK, *small)
    table = pd.read_csv(tmp_path / "drivers" / "drivers.csv")
    assert set(table["driver"]) == {"pure_pursuit", "stanley", "random"}
    assert "| stanley | infinity |" in (tmp_path / "drivers" / "drivers.md").read_text()

    for seed in (0, 1):
        run_here(
            "train_policy", engine, f"output={tmp_path / f'run_{seed}'}", f"seed={seed}",
            "ppo.cars=4", "ppo.batch_steps=32", "ppo.minibatch=64", "ppo.steps=256",
            "validations=2", "validation_steps=20", "policy.hidden=[4]", *SMALL_TASK,
        )  # fmt: skip
    run_here(
        "show_learning", f"runs.kinematic=[{tmp_path / 'run_0'},{tmp_path / 'run_1'}]",
        f"drivers.kinematic={tmp_path / 'drivers' / 'drivers.csv'}", f"output={tmp_path / 'l.png'}",
    )  # fmt: skip
    run_here(
        "show_policies", f"policies.mine={tmp_path / 'run_0' / 'last.pt'}", "courses=[lap]",
        "car=kinematic", f"pure_pursuit={tmp_path / 'drivers' / 'pure_pursuit.yaml'}",
        f"output={tmp_path / 'p.png'}",
    )  # fmt: skip
    for picture in ("l.png", "p.png"):
        assert (tmp_path / picture).read_bytes().startswith(b"\x89PNG")
    said = capsys.readouterr().out
    assert "kinematic, validation_waypoints: " in said
    assert "after 256 steps, pure pursuit " in said
    assert said.count("in its simulator") == 1


@pytest.fixture
def small(tmp_path: Path) -> list[str]:
    """A study of one model, on recordings of its own."""
    for number in range(3):
        name = f"sample_{number:02d}.csv"
        lines = (ROOT / "data" / "sample" / name).read_text().splitlines(keepends=True)
        (tmp_path / "drives").mkdir(exist_ok=True)
        (tmp_path / "drives" / name).write_text("".join(lines[:400]))
    data = yaml.safe_load(STUDY)["data"] | {"recordings": [str(tmp_path / "drives")]}
    content = {**yaml.safe_load(STUDY), "data": data}
    content["runs"]["MLP"]["preparations"] = ["raw"]
    (tmp_path / "study.yaml").write_text(yaml.safe_dump(content))
    return [str(tmp_path / "study.yaml"), f"output={tmp_path / 'out'}"]


def interrupted(*_) -> None:
    """In place of what ends a training."""
    raise KeyboardInterrupt


def test_a_stopped_training_goes_on_with_the_same_question_alone(
    run_here, small, tmp_path, monkeypatch
):
    models = tmp_path / "out" / "models"
    with monkeypatch.context() as patched:
        patched.setattr("buggy_rl.api.training.save_model", interrupted)
        with pytest.raises(KeyboardInterrupt):
            run_here("train_models", *small)
    assert sorted(file.name for file in models.glob("*.*")) == ["mlp__raw.checkpoint"]
    for name, (was, now) in {
        "epochs": (2, 3), "learning_rate": (0.002, 0.1), "batch_size": (256, 16), "seed": (0, 5),
    }.items():  # fmt: skip
        said = f"training.{name} was {was}, now {now}; fresh=true trains it again"
        with pytest.raises(SystemExit, match=rf"mlp__raw\.checkpoint answers .*: {said}"):
            run_here("train_models", *small, f"runs.MLP.training.{name}={now}")
    run_here("train_models", *small)
    assert list(read_log(models / "mlp__raw", "epoch")) == [1, 2]
    assert (models / "mlp__raw.pt").is_file()
    run_here("train_models", *small, "runs.MLP.training.epochs=3", "fresh=true")
    config = yaml.safe_load((models / "mlp__raw" / "config.yaml").read_text())
    assert config["training"]["epochs"] == 3


def test_a_model_of_other_recordings_of_the_same_names_is_not_taken(
    run_here, small, tmp_path, capsys
):
    run_here("train_models", *small)
    model, config = tmp_path / "out" / "models" / "mlp__raw.pt", tmp_path / "out" / "models"
    before = model.read_bytes(), (config / "config.yaml").read_text()
    first = tmp_path / "drives" / "sample_00.csv"
    lines = first.read_text().splitlines(keepends=True)
    first.write_text("".join(lines[:350]))
    with pytest.raises(SystemExit, match="recording sample_00 has other content now; fresh=true"):
        run_here("train_models", *small, "windows=10")
    assert before == (model.read_bytes(), (config / "config.yaml").read_text())
    first.write_text("".join(lines))
    capsys.readouterr()
    run_here("train_models", *small)
    assert "is there already" in capsys.readouterr().out
    first.write_text("".join(lines[:350]))
    run_here("train_models", *small, "fresh=true")  # the remedy
    run_here("train_models", *small)
    assert "is there already" in capsys.readouterr().out
