"""The scripts as a user runs them, on a small study; one after the other in one folder."""

import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
import yaml

ROOT = Path(__file__).parents[1]
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


def run(script: str, *arguments: str) -> subprocess.CompletedProcess:
    command = [sys.executable, f"scripts/{script}.py", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True)


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
