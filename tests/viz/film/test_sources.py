import numpy as np
import pytest
import torch

from buggy_rl.engines import make_engine
from buggy_rl.viz.film.sources import Part, of_recording, of_simulator, read_recording, track_of

FACTORY = """
from buggy_rl.engines import make_engine

def make(batch_size=(), device="cpu"):
    return make_engine("kinematic", batch_size, device)
"""


@pytest.fixture(scope="module")
def recording(repository):
    return read_recording(str(repository / "data" / "sample" / "sample_00.csv"))


def test_a_part_of_a_recording_is_shown_as_it_was_measured(recording):
    track = of_recording(recording, Part(start=2.0, seconds=1.5))
    assert track.duration == pytest.approx(1.5)
    assert track.time[0] - float(recording.data["t"][0, 0]) == pytest.approx(2.0)
    row = int((recording.data["t"][:, 0] - float(track.time[0])).abs().argmin())
    assert track.pose[0] == pytest.approx(recording.data["pose"][row].double().numpy())


def test_a_simulator_begins_where_the_recording_was_and_drives_its_commands(recording):
    part = Part(recording, start=3.0, seconds=1.0)
    measured = of_recording(recording, part)
    steps = []
    track = of_simulator(make_engine("single_track", 1), "st", part, lambda: steps.append(1))
    assert track.pose[0] == pytest.approx(measured.pose[0], abs=1e-5)
    assert (track.action == measured.action).all()
    assert len(steps) == len(track.time) - 1
    # And goes its own way: it is not the recording over again.
    assert np.abs(track.pose[-1, :2] - measured.pose[-1, :2]).max() > 1e-3


@pytest.mark.parametrize("kind", ["name", "yaml", "factory"])
def test_whatever_is_a_simulator_is_driven_round_a_course_by_pure_pursuit(tmp_path, kind):
    what = "kinematic"
    if kind == "yaml":
        (tmp_path / "car.yaml").write_text("engine: kinematic\n")
        what = str(tmp_path / "car.yaml")
    elif kind == "factory":
        (tmp_path / "my.py").write_text(FACTORY)
        what = f"{tmp_path / 'my.py'}:make"
    track = track_of(what, Part(seconds=2.0, course="lap"))
    assert track.name == {"name": "kinematic", "yaml": "car", "factory": "make"}[kind]
    assert track.waypoints is not None
    assert track.closed is not None
    assert track.closed[-1] > 3
    # It is where the waypoints that it closed are.
    last = track.waypoints[int(track.closed[-1])]
    assert np.hypot(*(track.pose[-1, :2] - last)) < 0.6
    assert track_of(what, Part(seconds=2.0)).pose == pytest.approx(track.pose)


@pytest.mark.parametrize(
    ("what", "part", "message"),
    [
        ("missing.pt", Part(), "there is no file missing.pt"),
        ("kinematic", Part(course="moon"), "course=moon: must be one of lap"),
        ("warp_drive", Part(), "warp_drive"),
    ],
)
def test_what_cannot_be_filmed_is_refused_in_a_line(what, part, message):
    with pytest.raises(ValueError, match=message):
        track_of(what, part)


def test_a_start_beyond_the_end_is_refused(recording):
    with pytest.raises(ValueError, match=r"start=9999: sample_00 has .* s only"):
        of_recording(recording, Part(start=9999.0))


def test_the_global_random_state_is_left_alone():
    torch.manual_seed(5)
    expected = torch.rand(1)
    torch.manual_seed(5)
    track_of("kinematic", Part(seconds=0.1))
    assert torch.equal(torch.rand(1), expected)
