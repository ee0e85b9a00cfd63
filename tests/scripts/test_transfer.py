"""The script as a user runs it: its help, its errors, and the whole chain on one car."""

import hashlib
import os
import subprocess
import sys

import pytest
import yaml

from buggy_rl.proof.transfer.arms import ARMS
from tests.running import run_script

QUICK = """
cars: 2
control_every: 2
seeds: [0]
steps: 6144
drives: 2
earlier: 3
seconds: 12.0
judged_seconds: 2.0
judged_drives: 1
fit: [fit_simulator=single_track, fit.windows=8, fit.iterations=2]
model: [runs.model.model.kind=mlp, runs.model.training.epochs=2]
diagnosis: [stretches=8, "effects=[steering_dead_time]"]
policy: [configs/shac.yaml, configs/ppo_car.yaml, validation_steps=50]
"""


def run(repository, *arguments):
    command = [sys.executable, "scripts/transfer.py", *arguments]
    return subprocess.run(command, cwd=repository, capture_output=True, text=True)


def test_help_answers_without_torch(repository):
    command = [sys.executable, "-X", "importtime", "scripts/transfer.py", "--help"]
    done = subprocess.run(command, cwd=repository, capture_output=True, text=True, check=True)
    assert "judged_seconds=60.0" in done.stdout
    assert "torch" not in done.stderr


def test_a_page_without_tables_is_refused_in_one_line(tmp_path):
    done = run_script("scripts/transfer.py", f"output={tmp_path}", "stages=page")
    assert done.returncode == 1
    assert "drives.csv: run the stages before page" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_whole_chain_leaves_a_table_and_does_nothing_twice(repository, tmp_path):
    study, out = tmp_path / "study.yaml", tmp_path / "out"
    study.write_text(QUICK)
    arguments = [str(study), f"output={out}"]
    done = run(repository, *arguments)
    assert done.returncode == 0, done.stderr
    text = (out / "transfer.md").read_text()
    assert f"| car | {' | '.join(ARMS)} |" in text
    assert (out / "transfer.png").read_bytes().startswith(b"\x89PNG")
    secret = (out / "secret.txt").read_bytes()
    assert (out / "secret.sha256").read_text().startswith(hashlib.sha256(secret).hexdigest())
    files = [file for file in out.rglob("*.pt") if file.is_file()]
    before = {file: os.stat(file).st_mtime_ns for file in files}
    assert len([file for file in before if file.name == "best.pt"]) == 2 * len(ARMS)
    again = run(repository, *arguments)
    assert again.returncode == 0, again.stderr
    assert {file: os.stat(file).st_mtime_ns for file in files} == before
    began = {}
    for arm in ("continued", "repaired"):
        file = out / f"cars/01/policies/{arm}_0/config.yaml"
        began[arm] = yaml.safe_load(file.read_text())["start"]
    given = str(out / "cars/01/policies/as_given_0/best.pt")
    assert began == {"continued": given, "repaired": ""}
