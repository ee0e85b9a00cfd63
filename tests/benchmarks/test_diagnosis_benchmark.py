"""The diagnosis benchmark: its drives, its choice of effects, its peers, its tables."""

import importlib
import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

from buggy_rl.core import keys
from buggy_rl.effects import EFFECTS
from buggy_rl.simulators.mujoco import MujocoEngine
from tests.running import run_script

STIFFNESS = "cornering_stiffness_rear"


@pytest.fixture(scope="module")
def part(request):
    """Imports a part of the benchmark as the script does, from its folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(request.config.rootpath / "benchmarks")
        yield lambda name: importlib.import_module(f"diagnosing.{name}")


@pytest.fixture
def job(part, tmp_path):
    def make(kind, name, seconds=0.0, **config):
        settings = part("job").Config(threads=1, **config)
        return part("job").Job(kind, name, str(tmp_path), settings, seconds)

    return make


def row(**changes):
    about = {"kind": "speed", "name": "mujoco", "asked": 0, "total_seconds": 90.0}
    times = {"seconds": 50.0, "cpu_seconds": 75.0, "peak_memory_mb": 1000.0}
    said = {"verdict": "missing_physics", "named": ["steering_dead_time"], "right": True}
    value = {"value": 0.061, "low": 0.05, "high": 0.07, "truth": 0.06, "candidates": 56}
    return {**about, **times, **said, **value, "baseline": True, "stages": {}, **changes}


@pytest.mark.parametrize("count", [1, 2, 8, 16, len(EFFECTS)])
def test_so_many_effects_are_chosen_and_the_true_one_is_among_them(part, count):
    names = part("diagnosed").choice(count)
    assert len(names) == count
    assert "steering_dead_time" in names
    assert names == [name for name in EFFECTS if name in names]  # in the library's order


def test_more_effects_than_there_are_are_refused(part):
    with pytest.raises(ValueError, match=f"1 to {len(EFFECTS)} effects"):
        part("diagnosed").choice(len(EFFECTS) + 1)


def test_time_is_counted_by_word_of_progress(part):
    begun = [(1.0, "trying 33 effects"), (3.0, "proving"), (4.0, "trying 7 effects")]
    stages = part("diagnosed").by_stage(begun, 10.0)
    assert stages == {"trying effects": 2.0 + 6.0, "proving": 1.0}


def test_the_changed_car_steers_late_and_the_right_one_does_not(part):
    def turning_after(kind):
        car = part("drives").car(kind, 1, dead_time=0.1)
        state = car.reset()
        state[keys.VELOCITY] = torch.tensor([[1.5, 0.0, 0.0]])
        for _ in range(8):  # 80 ms
            state[keys.ACTION] = torch.tensor([[-0.5, 1.0]])
            state = car.step(state)["next"]
        return float(state[keys.VELOCITY][0, 2])

    right = turning_after("right")
    assert right > 0.5
    assert abs(turning_after("changed")) < 0.1 * right  # what its wheels do straight ahead


def test_drives_are_files_of_which_the_first_seconds_can_be_had(part, job):
    drives = part("drives")
    drives.make_drives(job("drives", drives.RIGHT, seconds=4.0))
    folder = job("speed", "reference").file(drives.RIGHT)
    whole, half = drives.load(folder, 4.0), drives.load(folder, 2.0)
    assert [len(r) for r in whole] == [200, 200]
    assert [len(r) for r in half] == [100, 100]
    assert torch.equal(half[1].data[keys.POSE], whole[1].data[keys.POSE][:100])
    with pytest.raises(ValueError, match="shorter than 9 s"):
        drives.load(folder, 18.0)


def test_sysid_rolls_out_our_engine_from_the_same_segments(part, job):
    pytest.importorskip("scipy")
    peers, drives = part("peers"), part("drives")
    made = job("drives", drives.OFF, seconds=8.0, parameter=STIFFNESS, truth=6.0)
    drives.make_drives(made)
    recordings = drives.load(made.file(drives.OFF), 8.0)
    segments = peers.fit_segments(recordings, replace(peers.CONFIG, windows=4))
    p = MujocoEngine(1).declared[STIFFNESS]
    residuals = peers.Residuals(peers.Simulation(MujocoEngine), segments, [p])
    scaled = (np.array([[p.value, 6.0]]) - p.lower) / (p.upper - p.lower)
    shipped, right = residuals(scaled, None)[0][0].T
    # Four segments of ten instants, six readings each.
    assert shipped.shape == right.shape == (240,)
    assert (right**2).sum() < 0.5 * (shipped**2).sum()


def test_times_are_medians_of_the_rounds_and_memory_is_the_largest(part):
    rounds = [row(seconds=s, peak_memory_mb=m) for s, m in ((9.0, 5.0), (1.0, 7.0), (2.0, 6.0))]
    (one,) = part("tables").medians([*rounds, row(failed="no luck")])
    assert (one["seconds"], one["peak_memory_mb"]) == (2.0, 7.0)
    assert "failed" not in one


@pytest.mark.parametrize(
    ("changes", "met"),
    [
        ({}, "yes"),  # MuJoCo has 90 s
        ({"name": "reference"}, "no"),  # a PyTorch engine 20 s
        ({"peak_memory_mb": 5000.0}, "no"),  # all of them 4 GB
    ],
)
def test_a_row_says_whether_the_target_is_met(part, changes, met):
    line = part("tables").tables([row(**changes)]).splitlines()[2]
    assert f"| {met} | steering_dead_time | 61 (50 .. 70), true 60 | yes |" in line


def test_a_peer_without_an_answer_and_a_process_that_failed_are_shown_as_such(part):
    peers = [
        row(kind="peer", name="diagnosis", parameter="mass", value=None, named=["payload"]),
        row(kind="peer", name="sysid", parameter="mass", free=1, truth=0.08),
        row(kind="peer", name="sysid_all", parameter="mass", failed="pip install it"),
    ]
    table = part("tables").tables(peers)
    assert "not named | named: payload | no |" in table
    assert "| 0.061 | 0.05 .. 0.07 | no |" in table  # 0.08 is not in it
    assert "failed: pip install it" in table


@pytest.mark.parametrize("wrong", ["parts=[sped]", "peers=[csysid]", "figure=x.png"])
def test_what_cannot_be_measured_is_refused_at_once(wrong):
    more = ["parts=[speed]"] if wrong.startswith("figure") else []
    done = run_script("benchmarks/diagnosis.py", wrong, *more)
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith("error: ")


@pytest.mark.slow
def test_the_script_leaves_tables_figures_and_a_picture(repository, tmp_path):
    command = [
        *(sys.executable, "benchmarks/diagnosis.py", "parts=[scale,sysid]", "threads=1"),
        *("seconds=9", "lengths=[18]", "candidates=[2]", "peers=[fit,sysid]"),
        *(f"figure={tmp_path / 'a.png'}", f"output={tmp_path / 'a.json'}"),
    ]
    done = subprocess.run(command, cwd=repository, capture_output=True, text=True, check=True)
    assert f"{STIFFNESS}, true 6:" in done.stdout
    rows = json.loads((tmp_path / "a.json").read_text())["rows"]
    assert [r["kind"] for r in rows] == ["length", "candidates", "peer", "peer"]
    assert not [r for r in rows if "failed" in r]
    assert all(r["seconds"] > 0 and r["peak_memory_mb"] > 0 for r in rows)
    assert (tmp_path / "a.png").stat().st_size > 0
