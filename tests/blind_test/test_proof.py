"""The proof itself, small: sealed cases, asked, weighed, counted, on the script's command line.

Drives of 12 s and a library of five effects, so that it fits into the tests; configs/proof.yaml
has the real ones.
"""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from buggy_rl.blind_test.sealing import Vault

ROOT = Path(__file__).parents[2]
OPTIONS = (
    "draw.each=true", "draw.nothing=1", "draw.cases=3", "draw.seconds=[12.0]",
    "draw.pairings=[reference]", "draw.nuisances=[white]", "draw.driving=[rich]",
    "draw.names=[steering_gain,gyro_bias]", "rivals=2",
    "effects=[steering_gain,steering_offset,viscous_drag,gyro_bias,sensor_yaw]",
)  # fmt: skip


KILLED = """
import sys
from pathlib import Path
from buggy_rl.config import run
from buggy_rl.blind_test.proof import side_by_side
from tests.blind_test.test_proof import linger
run(lambda: list(side_by_side(linger, [(Path(sys.argv[1]),)], 1)))
"""


def linger(file: Path) -> None:
    """Tells its process, and stays."""
    file.with_suffix(".partial").write_text(str(os.getpid()))
    file.with_suffix(".partial").replace(file)
    time.sleep(60)


def prove(folder: Path, *more: str) -> subprocess.CompletedProcess:
    command = [sys.executable, "scripts/prove.py", f"output={folder}", *OPTIONS, *more]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True)


@pytest.fixture(scope="module")
def proof(tmp_path_factory) -> tuple[Path, subprocess.CompletedProcess]:
    folder = tmp_path_factory.mktemp("proof") / "run"
    return folder, prove(folder)


@pytest.mark.timeout(900)  # half of it waiting, where other tests have the other core
def test_what_is_concealed_is_found_and_nothing_where_nothing_is(proof):
    folder, done = proof
    assert done.returncode == 0, done.stderr
    vault = Vault(folder, Path(f"{folder}_sealed"))
    for case in vault.cases():
        answer = json.loads((vault.said(case.id) / "diagnosis.json").read_text())
        assert {effect["name"] for effect in answer["effects"]} == set(case.truth)
        weighed = json.loads(vault.weighed(case.id).read_text())
        if not case.truth:
            assert "nats" not in weighed
            continue
        assert min(weighed["nats"], *weighed["rivals"].values()) > 10
        (effect,) = case.truth
        for name, value in case.concealed[effect].items():
            assert weighed["parameters"][effect][name] == pytest.approx(value, rel=0.1)
    page = (folder / "proof.md").read_text()
    assert "first name right, decidable single effects | at least 90 % | 100.0 % (34.2" in page


@pytest.mark.timeout(900)
def test_what_is_done_is_not_done_again(proof):
    folder, _ = proof
    before = {p: p.stat().st_mtime_ns for p in folder.rglob("*.csv")}
    before |= {p: p.stat().st_mtime_ns for p in folder.rglob("outcome.json")}
    assert len(before) > 6
    done = prove(folder)
    assert done.returncode == 0, done.stderr
    assert {p: p.stat().st_mtime_ns for p in before} == before


def test_workers_end_with_a_parent_that_is_killed(tmp_path):
    command = [sys.executable, "-c", KILLED, str(tmp_path / "pid")]
    parent = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.DEVNULL)
    while not (tmp_path / "pid").exists():
        time.sleep(0.05)
    parent.send_signal(signal.SIGTERM)
    assert parent.wait(20) != 0
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "pid").read_text()), 0)
