"""The model of where more workers stop paying, by hand; and the refusal where there is no GPU."""

import sys
from pathlib import Path

import pandas as pd
import pytest
import torch

from buggy_rl.core import keys
from buggy_rl.simulators import make_engine
from tests.running import Done, run_script

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "benchmarks"))

from scaling.graphs import recorded  # noqa: E402
from scaling.model import Costs, Work, efficiency, most_workers, needed, wall  # noqa: E402

WORK = Work("work", 100, seconds=9.0, bytes=1e6)
COSTS = Costs(cluster=5.0, start=1.0, driver=0.1, disk=10e6)


def test_few_workers_share_the_work():
    assert wall(WORK, COSTS, 1) == 5.0 + 100 * 10.0
    assert wall(WORK, COSTS, 3) == 5.0 + 34 * 10.0  # the last round has one job
    assert efficiency(WORK, COSTS, 1) == pytest.approx(900.0 / 1005.0)


def test_many_workers_wait_for_the_driver_or_the_disk():
    assert wall(WORK, COSTS, 100) == 5.0 + 10.0  # both take 100 x 0.1 s as well
    assert wall(WORK, Costs(5.0, 1.0, 0.5, 10e6), 100) == 5.0 + 50.0
    assert wall(WORK, Costs(5.0, 1.0, 0.1, 1e6), 100) == 5.0 + 100.0
    assert most_workers(WORK, COSTS) == 100
    assert most_workers(WORK, Costs(5.0, 1.0, 0.5, 10e6)) == 20


def test_the_fewest_workers_for_a_deadline():
    assert needed(WORK, COSTS, 1005.0) == 1
    assert needed(WORK, COSTS, 505.0) == 2
    assert needed(WORK, COSTS, 14.0) is None


def gpu(*options: str) -> Done:
    return run_script("benchmarks/gpu.py", *options)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_missing_gpu_is_refused_with_what_to_do(tmp_path):
    done = gpu(f"output={tmp_path / 'gpu.csv'}")
    assert done.returncode == 1
    assert "error: device=cuda: torch" in done.stderr
    assert "finds no GPU here; run this on a machine with one" in done.stderr
    assert not (tmp_path / "gpu.csv").exists()


@pytest.mark.slow
def test_the_same_code_measures_the_processor(tmp_path):
    file = tmp_path / "cpu.csv"
    small = ("engines=[kinematic]", "cars=[8]", "training=[8]", "sets=[1]", "seconds=0.05")
    done = gpu("device=cpu", *small, "repeats=1", f"output={file}")
    assert done.returncode == 0, done.stderr
    table = pd.read_csv(file).set_index("what")
    assert list(table.index) == ["environment", "ppo", "diagnosis"]
    assert table.machine.notna().all()
    assert table.steps_per_s["environment"] < table.floor_steps_per_s["environment"]
    assert table.rollouts_per_s["diagnosis"] > 0


def test_a_stopped_measurement_goes_on_behind_its_rows(tmp_path):
    file = tmp_path / "cpu.csv"
    small = ("device=cpu", "cars=[8]", "training=[]", "sets=[]", "seconds=0.05", "repeats=1")
    assert gpu(*small, "engines=[kinematic]", f"output={file}").returncode == 0
    first = file.read_text()
    assert gpu(*small, "engines=[kinematic,hold]", f"output={file}").returncode == 0
    assert file.read_text().startswith(first)
    assert list(pd.read_csv(file).engine) == ["kinematic", "hold"]


def test_a_graph_is_recorded_on_a_gpu_alone():
    with pytest.raises(ValueError, match="a CUDA graph needs an engine on a GPU, not on cpu"):
        recorded(make_engine("kinematic", 2))


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU here")
def test_a_recorded_step_is_the_same_to_the_last_bit():
    plain, fast = (make_engine("single_track", 64, "cuda") for _ in range(2))
    recorded(fast)
    state, other = plain.reset(), fast.reset()
    with torch.no_grad():
        for action in torch.linspace(-1.0, 1.0, 20 * 64 * 2, device="cuda").view(20, 64, 2):
            state = plain.step(state.set(keys.ACTION, action))["next"]
            other = fast.step(other.set(keys.ACTION, action))["next"]
    assert torch.equal(other[keys.POSE], state[keys.POSE])
    assert torch.equal(other[keys.VELOCITY], state[keys.VELOCITY])
