import runpy
import sys
from pathlib import Path

import pandas as pd
import pytest
import torch
import yaml

from buggy_rl.core import keys
from buggy_rl.recordings import load_recordings

ROOT = Path(__file__).parents[2]
SAMPLE = ROOT / "data" / "sample"


@pytest.fixture
def record(monkeypatch):
    """Runs the script in this process with the given arguments, from the root of the project."""

    def run(*arguments):
        monkeypatch.chdir(ROOT)
        monkeypatch.setattr(sys, "argv", ["scripts/record.py", *arguments])
        runpy.run_path("scripts/record.py", run_name="__main__")

    return run


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_what_is_recorded_is_read_back_by_everyone_else(record, capsys, tmp_path, form):
    record(f"output={tmp_path}", "drives=2", "seconds=2.5", "seed=4", f"format={form}")
    assert "2 drives" in capsys.readouterr().out
    recordings, refusals = load_recordings(tmp_path)
    assert not refusals
    assert [r.name for r in recordings] == ["drive_00", "drive_01"]
    for recording in recordings:
        assert len(recording) == 250
        assert recording.data[keys.SEGMENT].max() == 0
        assert recording.data[keys.VELOCITY][:20].abs().max() < 0.2  # rest and noise
        assert recording.data[keys.VELOCITY][:20].std(0).min() > 0.01


def test_the_same_seed_writes_the_same_file_and_dropped_frames_are_missing_rows(record, tmp_path):
    options = ["drives=1", "seconds=1.5", "camera.dropped_share=0.1"]
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        record(f"output={tmp_path / name}", f"seed={seed}", *options)
    one, two, other = (pd.read_csv(tmp_path / n / "drive_00.csv") for n in "abc")
    pd.testing.assert_frame_equal(one, two)
    assert not one.equals(other)
    assert 110 < len(one) < 149
    assert one["t"].diff().max() > 0.015


def test_a_wrong_option_is_refused_by_name(record, tmp_path):
    with pytest.raises(SystemExit, match="secconds"):
        record(f"output={tmp_path}", "secconds=3")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_concealed_fault_is_in_the_drives_and_its_name_where_it_was_sealed(record, tmp_path):
    plain, riddle, answer = (tmp_path / name for name in ("plain", "riddle", "answer"))
    common = ["drives=1", "seconds=2.5", "seed=4"]
    record(f"output={plain}", *common)
    fault = ["faults.payload.mass_ratio=1.5", "camera.gyro_bias=0.1"]
    record(f"output={riddle}", *common, *fault, f"sealed={answer}")
    assert [file.name for file in riddle.iterdir()] == ["drive_00.csv"]
    assert (plain / "config.yaml").is_file()
    config = yaml.safe_load((answer / "config.yaml").read_text())
    assert config["faults"] == {"payload": {"mass_ratio": 1.5}}
    assert config["camera"]["gyro_bias"] == 0.1
    one, two = (pd.read_csv(folder / "drive_00.csv") for folder in (plain, riddle))
    assert list(one.columns) == list(two.columns)
    assert two["vx"].mean() < 0.95 * one["vx"].mean()
    assert (two["yaw_rate"] - one["yaw_rate"])[:20].mean() == pytest.approx(0.1, abs=1e-3)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("faults.payload.mass=1.5", "no fault payload.mass; available: .*payload.mass_ratio"),
        ("faults.payload.mass_ratio=9", "must be in"),
        ("sealed={output}/answer", "name a folder elsewhere"),
        ("sealed={output}", "name a folder elsewhere"),
    ],
)
def test_an_impossible_riddle_is_one_line_and_leaves_nothing(record, tmp_path, wrong, message):
    output = tmp_path / "out"
    with pytest.raises(SystemExit, match=message):
        record(f"output={output}", "drives=1", "seconds=1", wrong.format(output=output))
    assert not output.exists()


def test_the_sample_is_small_accepted_and_complete():
    recordings, refusals = load_recordings(SAMPLE)
    assert not refusals
    assert len(recordings) == 9
    assert sum(r.duration for r in recordings) == pytest.approx(360.0)
    assert sum(f.stat().st_size for f in SAMPLE.iterdir()) < 5e6
    velocity = torch.cat([r.data[keys.VELOCITY] for r in recordings])
    action = torch.cat([r.data[keys.ACTION] for r in recordings])
    assert velocity[:, 0].max() > 3.0
    assert (action[:, 0] > 0.6).float().mean() > 0.01
    assert (velocity[:, 0].abs() < 0.1).float().mean() > 0.03


def test_the_sample_is_what_its_config_records(record, tmp_path):
    record("configs/record_sample.yaml", f"output={tmp_path}", "seconds=1.5")
    commands, place = ["t", "throttle", "steering"], ["x", "y"]
    for file in sorted(tmp_path.glob("*.csv")):
        fresh, kept = pd.read_csv(file), pd.read_csv(SAMPLE / file.name)[:150]
        pd.testing.assert_frame_equal(fresh[commands], kept[commands], atol=1e-3)
        # Camera noise is drawn for the whole length at once: another 1.5 s has another noise.
        pd.testing.assert_frame_equal(fresh[place], kept[place], atol=0.01)


@pytest.mark.slow
def test_a_larger_car_with_brakes_is_driven_about_a_larger_room(record, capsys, tmp_path):
    command = "options.command=throttle_brake_reverse"
    options = ["driver=manoeuvring", "car=autorally", command, "drives=4", "seconds=12"]
    options += ["options.substep=0.0025"]  # half as many as usual
    record(f"output={tmp_path}", *options)
    farthest = float(capsys.readouterr().out.split("|x| or |y| ")[1].split()[0])
    assert farthest < 4.0 * 0.57 / 0.174
    recordings, refusals = load_recordings(tmp_path, tmp_path / "columns.yaml", car="autorally")
    assert not refusals
    vx = torch.cat([r.data[keys.VELOCITY][:, 0] for r in recordings])
    assert vx.max() > 2.5
    assert vx.min() < -0.3
