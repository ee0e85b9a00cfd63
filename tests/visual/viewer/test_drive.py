"""A person, or who stands in, drives a simulator through the page."""

import json
import subprocess
import sys

import pytest
import torch

from buggy_rl.car.clock import Deadlines
from buggy_rl.car.human import HumanConfig, HumanInput
from buggy_rl.policies.people import (
    DriveConfig,
    ScriptedInput,
    drive_environment,
    live_steps,
    start,
)
from buggy_rl.recordings import load_recordings
from buggy_rl.visual.viewer.control_page import ControlPage
from tests.visual.viewer.client import Keys, wait_until


@pytest.fixture
def human():
    return HumanInput(HumanConfig())


@pytest.fixture
def page(human):
    page = ControlPage(human)
    yield page
    page.close()


@pytest.mark.parametrize(("steering", "side"), [(1, 1), (-1, -1)])
def test_keys_held_drive_a_car_to_their_side(page, human, steering, side):
    config = DriveConfig("unused.csv", simulator="kinematic", course="none")
    env = drive_environment(config)
    keys = Keys(page, throttle=1, steering=steering)
    try:
        wait_until(lambda: not human.silent)
        driven = list(live_steps(env, start(env), human, 60, Deadlines(0.01)))
    finally:
        keys.release()
    x, y, yaw = driven[-1].values[:3]
    assert x > 0.01
    assert side * y > 0
    assert side * yaw > 0.01


def hurried():
    """Deadlines that nobody waits for."""
    return Deadlines(0.01, clock=lambda: 0.0, sleep=lambda seconds: None)


def test_nobody_at_the_keys_leaves_the_car_where_it_is(human):
    env = drive_environment(DriveConfig("unused.csv", simulator="kinematic", course="none"))
    driven = list(live_steps(env, start(env), human, 20, hurried()))
    assert len(driven) == 20
    assert driven[-1].values == pytest.approx((0, 0, 0, 0, 0, 0, -1, 0), abs=1e-6)


def test_a_car_that_drives_straight_on_leaves_the_lap_and_that_ends_the_drive():
    class Straight:
        def command(self, dt):
            return 0.0, 0.0

    env = drive_environment(DriveConfig("unused.csv", simulator="kinematic"))
    driven = list(live_steps(env, start(env), Straight(), 1000, hurried()))
    assert driven[-1].done
    assert len(driven) < 1000
    # The straight is 2 m of waypoints 0.2 m apart; those of the bend are not all passed near by.
    assert 9 <= driven[-1].waypoints <= 14


def test_a_scripted_driver_closes_waypoints_one_after_the_other():
    def driver(state):
        return state.set("action", torch.tensor([[0.0, 0.0]]))

    env = drive_environment(DriveConfig("unused.csv", simulator="kinematic"))
    driven = list(live_steps(env, start(env), ScriptedInput(driver), 150, hurried()))
    assert [row.following for row in driven] == sorted(row.following for row in driven)
    assert driven[-1].waypoints > 3


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"driver": "scripted", "course": "none"}, "course=lap"),
        ({"driver": "keyboard", "view": False}, "view=true"),
        ({"seconds": -1.0}, "seconds=-1"),
        ({"countdown": 100.0}, "countdown=100"),
    ],
)
def test_options_that_do_not_go_together_are_refused(options, named):
    with pytest.raises(ValueError, match=named):
        DriveConfig("unused.csv", **options)


@pytest.mark.slow
def test_the_script_records_a_scripted_drive_and_says_so(tmp_path):
    file = tmp_path / "lap_0.csv"
    command = ["scripts/drive.py", "driver=scripted", "view=false", "simulator=kinematic",
               "seconds=2", f"output={file}"]  # fmt: skip
    done = subprocess.run([sys.executable, *command], capture_output=True, text=True, check=True)
    assert "scripted driver" in done.stdout
    note = json.loads(file.with_suffix(".json").read_text())
    assert note["driver"] == "scripted"
    assert note["finished"]
    assert note["waypoints"] > 3
    (recording,), refused = load_recordings(file)
    assert not refused
    assert len(recording) == 200
