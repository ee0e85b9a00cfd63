"""What an inspection says of drives that it cannot map as they are named."""

import numpy as np
import pandas as pd
import pytest

from buggy_rl.inspection.clock import find_clock, why_no_clock
from buggy_rl.inspection.coverage import is_end
from buggy_rl.inspection.drive import facts_of
from buggy_rl.inspection.folder import inspect_folder, listing
from buggy_rl.inspection.proposal import chosen_commands, proposal
from buggy_rl.inspection.signals import RawDrive
from buggy_rl.recordings import load_recordings
from buggy_rl.recordings.columns import load_columns
from buggy_rl.recordings.readers import Table
from tests.recordings.conftest import ideal_drive


@pytest.fixture(scope="module")
def drive():
    frame = ideal_drive(seconds=20.0, noise=5e-4, agility=2.0)
    return frame.assign(throttle=np.clip(2.2 * frame.throttle - 0.2, -1, 1))


def inspected(frame: pd.DataFrame, folder):
    frame.to_csv(folder / "drive.csv", index=False)
    return inspect_folder(folder)


def test_commands_in_each_others_columns_are_found_said_and_read_by_the_proposed_map(
    drive, tmp_path
):
    steering = drive.steering / drive.steering.abs().max()
    changed = drive.assign(throttle=steering, steering=drive.throttle)
    found = inspected(changed, tmp_path)
    assert found.commands["steering"].column == "throttle"
    assert found.commands["throttle"].column == "steering"
    [line] = found.first
    assert line.startswith("throttle and steering are exchanged")
    assert f"# {line}" in found.proposal
    (tmp_path / "map.yaml").write_text(found.proposal)
    [recording], refusals = load_recordings(tmp_path / "drive.csv", tmp_path / "map.yaml")
    assert refusals == []
    row = np.round(recording.data["t"][:, 0].numpy() * 100).astype(int)
    action = recording.data["action"].numpy()
    assert np.allclose(action[:, 1], steering.to_numpy()[row], atol=1e-3)
    assert np.allclose(action[:, 0], drive.throttle.to_numpy()[row], atol=1e-3)


def test_commands_in_their_own_columns_are_not_exchanged(drive, tmp_path):
    found = inspected(drive, tmp_path)
    assert found.first == []
    assert {c: g.column for c, g in found.commands.items()} == {
        "steering": "steering",
        "throttle": "throttle",
    }


def test_a_clock_that_is_set_in_mid_drive_costs_no_memory_and_is_said(drive, tmp_path):
    late = drive.assign(t=np.where(drive.t < 10, drive.t, drive.t + 1.7e9))
    found = inspected(late, tmp_path)
    [facts] = found.drives
    assert facts.pose is not None
    assert facts.pose.clock.seconds == pytest.approx(20, abs=0.1)
    assert facts.pose.clock.jumps[0].row == 1000
    assert "row 1000: the clock was set forward by 1700000000 s" in facts.notes[0]
    assert found.commands["steering"].column == "steering"


def test_a_clock_that_is_set_back_is_a_clock(drive):
    t = drive.t.to_numpy().copy()
    t[1000:] -= 2.5
    clock = find_clock({"t": t, "x": drive.x.to_numpy()})
    assert clock is not None
    assert (np.diff(clock.t) > 0).all()
    assert clock.jumps[0].size == pytest.approx(-2.5)


def test_the_column_that_comes_nearest_to_a_clock_is_named(drive):
    t = np.floor(drive.t.to_numpy() * 20) / 20  # each stamp five times
    why = why_no_clock({"stamp": t, "x": drive.x.to_numpy()})
    assert "stamp comes nearest, 80.0% of its steps, first at row 1, do not" in why
    fast = {"stamp": np.arange(10) / 3000}
    assert find_clock(fast) is None
    assert "in none of s, ms, us, ns do rows come at 4 to 1100 Hz (in s: 3e+03 Hz)" in (
        why_no_clock(fast)
    )


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (
            lambda f: f.assign(x=-89.4 + f.x / 81_000, y=43.07 + f.y / 111_000),
            "x and y look like longitude and latitude in degrees: project them to metres (UTM)",
        ),
        (lambda f: f.assign(yaw=f.yaw + np.pi / 2), "is -90 degrees from yaw all the time"),
        (lambda f: f.assign(yaw=f.yaw[::-1].to_numpy()), "yaw comes nearest, mean cosine"),
        (lambda f: f.assign(x=1.0, y=f.y / 1000), "none are named as x and y"),
        (lambda f: f.assign(x=f.x / 1000, y=f.y / 1000), "x and y hardly move"),
        (lambda f: f.rename(columns={"x": "a", "y": "b"}), "none are named as x and y"),
    ],
)
def test_a_drive_without_a_pose_says_why(change, why, drive, tmp_path):
    frame = change(drive)
    found = inspected(frame[[c for c in ("t", "x", "y", "a", "b", "yaw") if c in frame]], tmp_path)
    [line] = [line for line in found.missing if "without a pose" in line]
    assert why in line


def test_every_numeric_column_is_listed_with_what_it_may_be(drive, tmp_path):
    frame = drive[["t", "x", "y"]].assign(
        heading=np.degrees(np.arctan2(np.sin(9 * drive.yaw), np.cos(9 * drive.yaw))),
        servo=np.round(1500 + 400 * drive.steering),
        armed=drive.t > 5,
        frame="map",
        zero=0,
        lap=np.where(np.arange(len(drive)) % 2, np.floor(drive.t), np.nan),
    )
    frame["armed"] = frame.armed.astype(int)
    facts = {c.name: c for c in inspected(frame, tmp_path).columns}
    assert list(facts) == ["t", "x", "y", "heading", "servo", "armed", "zero", "lap"]
    assert facts["t"].guess == "time [s]"
    assert facts["heading"].guess == "a heading in deg, wrapped"
    assert facts["servo"].guess == "a pulse of a servo or speed controller [us]"
    assert (facts["armed"].guess, facts["zero"].guess) == ("a switch", "constant")
    assert facts["lap"].guess == "a clock or a counter"
    assert facts["lap"].blank == 0.5
    assert facts["lap"].rate == pytest.approx(19 / 20, rel=0.01)  # 20 seconds, 19 changes
    assert "50% blank" in facts["lap"].line()


def test_rows_of_several_sources_in_one_table_are_seen_together(drive, tmp_path):
    pose = drive[["t", "x", "y", "yaw"]]
    commands = drive[["t", "throttle", "steering"]].assign(t=drive.t + 0.004)[::2]
    found = inspected(pd.concat([pose, commands]).sort_values("t"), tmp_path)
    assert found.missing == []
    assert found.commands["steering"].column == "steering"
    assert any("rows of several sources" in note for note in found.drives[0].notes)


def numbered(frame: pd.DataFrame, *columns) -> Table:
    """A table without a line of names."""
    return Table("t.csv", {str(i): np.asarray(c) for i, c in enumerate(columns)})


def test_columns_without_names_are_found_by_what_they_hold(drive):
    """Odometry and Ackermann commands as ROS prints them: seconds, nanoseconds, frame, fields."""
    seconds = np.floor(drive.t).astype(int)
    stamp = 1_700_000_000 + seconds, np.round((drive.t - seconds) * 1e9).astype(int)
    zero, half = 0 * drive.t, drive.yaw / 2
    frame = np.array(["map"] * len(drive), object)
    place = (drive.x, drive.y, zero, zero, zero, np.sin(half), np.cos(half))
    odometry = numbered(drive, *stamp, frame, frame, *place, *[zero] * 36, drive.vx, drive.vy)
    angle = np.clip(0.5 * drive.steering, -0.2, 0.2)
    command = numbered(drive, *stamp, frame, angle, zero, 2.5 * (drive.throttle + 1), zero)
    tables = {"odom": odometry, "drive": command}
    raw = RawDrive("d", tables, {"odom": "odom.csv", "drive": "drive.csv"})
    facts = facts_of(raw)
    assert facts.pose is not None
    assert facts.pose.names == {**{"x": "4", "y": "5", "qw": "10", "qx": "7", "qy": "8", "qz": "9"}}
    assert "odom.csv: no header line: columns are numbered 0 to 48" in facts.notes
    commands = chosen_commands([facts])
    assert commands["steering"].column == "drive.3"
    assert commands["throttle"].column == "drive.5"
    text = proposal([facts], commands)
    assert '{file: odom.csv, time: {"0": s, "1": ns}}' in text
    assert "steering: {right: -0.2, left: 0.2}" in text  # where it is clipped
    assert "qx: odom.7" in text
    assert "wheel_speed" not in text
    assert {c.name: c.guess for c in listing(facts)}["odom.4"] == "x"


def test_an_end_is_where_a_command_is_clipped_and_not_what_it_reached():
    t = np.arange(0, 60, 0.02)
    ramp = 1.3 * np.sin(t)
    assert not is_end(ramp, float(ramp.max()))
    assert is_end(ramp.clip(-1, 1), 1.0)
    steps = np.repeat([1.0, 2.0, 3.0], 100)
    assert not is_end(steps, 3.0)


def test_an_unknown_end_has_to_be_written_before_the_map_is_read(drive, tmp_path):
    found = inspected(drive.assign(steering=300 * drive.steering), tmp_path)
    (tmp_path / "map.yaml").write_text(found.proposal)
    with pytest.raises(ValueError, match=r"needed but not given: steering\.left, steering\.right"):
        load_columns(tmp_path / "map.yaml")
    written = found.proposal.replace('right: "???", left: "???"', "right: -300, left: 300")
    (tmp_path / "map.yaml").write_text(written)
    assert len(load_recordings(tmp_path / "drive.csv", tmp_path / "map.yaml")[0]) == 1
