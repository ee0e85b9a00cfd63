"""The script as a user runs it: its help, its errors, and the whole chain on one car."""

import os
import subprocess
import sys

import pytest

from tests.running import run_script

QUICK = """
cars: {late: {steering_dead_time: {dead_time: 0.08}}}
seeds: [0]
steps: 16384
drives: 3
seconds: 12.0
judged_seconds: 2.0
judged_drives: 1
diagnosis: [stretches=16, "effects=[steering_dead_time]"]
model: [runs.model.model.kind=mlp, runs.model.training.epochs=2]
policy: [configs/ppo.yaml, validation_steps=50]
"""

FITTED = """
engine: mujoco
parameters: {grip_front: 0.8}
_fit: {grip_front: {low: 0.75, high: 0.85}}
"""


def run(repository, *arguments):
    command = [sys.executable, "scripts/transfer.py", *arguments]
    return subprocess.run(command, cwd=repository, capture_output=True, text=True)


def test_help_answers_without_torch(repository):
    command = [sys.executable, "-X", "importtime", "scripts/transfer.py", "--help"]
    done = subprocess.run(command, cwd=repository, capture_output=True, text=True, check=True)
    assert "judged_seconds=60.0" in done.stdout
    assert "torch" not in done.stderr


def test_a_study_without_cars_is_refused_in_one_line(tmp_path):
    done = run_script("scripts/transfer.py", f"output={tmp_path}")
    assert done.returncode == 1
    assert "error: no car: name some" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_whole_chain_leaves_a_table_and_does_nothing_twice(repository, tmp_path):
    simulator, study = tmp_path / "mujoco.yaml", tmp_path / "study.yaml"
    simulator.write_text(FITTED)
    study.write_text(QUICK)
    arguments = [str(study), f"simulator={simulator}", f"output={tmp_path / 'out'}"]
    done = run(repository, *arguments)
    assert done.returncode == 0, done.stderr
    text = (tmp_path / "out" / "transfer.md").read_text()
    assert "| car | unrepaired | repaired | learned | randomised |" in text
    assert (tmp_path / "out" / "transfer.png").read_bytes().startswith(b"\x89PNG")
    files = [file for file in (tmp_path / "out").rglob("*.pt") if file.is_file()]
    before = {file: os.stat(file).st_mtime_ns for file in files}
    assert len([file for file in before if file.name == "best.pt"]) == 4
    again = run(repository, *arguments)
    assert again.returncode == 0, again.stderr
    assert {file: os.stat(file).st_mtime_ns for file in files} == before
