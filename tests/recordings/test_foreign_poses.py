"""Poses that are none: degrees on the globe, quaternions in another order or frame, other units."""

import re

import numpy as np
import pytest

from buggy_rl.recordings import ColumnMap, RecordingError, load_recording
from buggy_rl.recordings.columns import load_columns
from buggy_rl.recordings.loading import telling

VELOCITY = ["vx", "vy", "yaw_rate"]
DEGREE = 111_195.0  # [m] of a great circle


def refused(path, **keywords) -> str:
    with pytest.raises(RecordingError) as caught:
        load_recording(path, **keywords)
    return str(caught.value)


def geographic(frame, longitude=-89.4, latitude=43.07):
    return frame.assign(
        x=longitude + frame.x / (DEGREE * np.cos(np.radians(latitude))),
        y=latitude + frame.y / DEGREE,
    )


@pytest.mark.parametrize("velocity", ["measured", "derived"])
@pytest.mark.parametrize("order", ["longitude first", "latitude first"])
def test_degrees_of_longitude_and_latitude_are_refused_with_their_projection(
    velocity, order, good, write
):
    place = geographic(good, longitude=139.7, latitude=35.6)
    if order == "latitude first":
        place = place.rename(columns={"x": "y", "y": "x"})
    if velocity == "derived":
        place = place.drop(columns=VELOCITY)
    message = refused(write(place))
    assert "looks like longitude and latitude in degrees" in message
    scale, east, north = re.search(
        r"x = (\d+) cos\(latitude\) \(longitude ([+-].*?)\), y = \d+ \(latitude ([+-].*?)\)",
        message,
    ).groups()
    lon, lat = ("y", "x") if order == "latitude first" else ("x", "y")
    flat = place.assign(
        x=float(scale) * np.cos(np.radians(place[lat])) * (place[lon] + float(east)),
        y=float(scale) * (place[lat] + float(north)),
    )
    assert load_recording(write(flat)).duration > 19.9


def test_a_car_that_stands_or_creeps_is_not_taken_for_degrees(good, write):
    still = {"y": 0.0, "yaw": 0.0, "vx": 0.0, "vy": 0.0, "yaw_rate": 0.0}
    for size in (1e-4, 1e-5, 1e-6):
        noise = size * np.random.default_rng(0).standard_normal(len(good))
        for x in (noise, size * np.sin(good.t)):
            notes = load_recording(write(good.assign(**still, x=1 + x))).notes
            assert [n for n in notes if "never moves" in n]


def quaternion(frame, order="wxyz"):
    """Orientation under names that take the file's order for another: w first."""
    half = frame.yaw.to_numpy() / 2
    zero = np.zeros(len(half))
    parts = {"w": np.cos(half), "x": zero, "y": zero, "z": np.sin(half)}
    named = {f"q{name}": parts[part] for name, part in zip("wxyz", order, strict=True)}
    return frame.drop(columns="yaw").assign(**named)


@pytest.fixture
def straight(make_drive):
    """Eight seconds in which the heading stays within 45 degrees of 0."""
    frame = make_drive(seconds=8.0, noise=2e-4)
    yaw = np.unwrap(frame.yaw)
    assert np.ptp(yaw) < np.pi / 2  # so that no wrong order tilts the car
    middle = (yaw.max() + yaw.min()) / 2
    cos, sin = np.cos(middle), np.sin(middle)
    return frame.assign(
        x=cos * frame.x + sin * frame.y, y=cos * frame.y - sin * frame.x, yaw=yaw - middle
    )


@pytest.mark.parametrize("order", ["xyzw", "wzyx", "zwxy"])
@pytest.mark.parametrize("drive", ["good", "straight"])
def test_the_order_of_a_quaternion_is_named_whether_the_car_turns_or_not(
    drive, order, request, write, tmp_path
):
    frame = request.getfixturevalue(drive)
    path = write(quaternion(frame, order))
    message = refused(path)
    names = re.search(r"set names: (\{qw.*?\})", message)
    assert names, message
    (tmp_path / "map.yaml").write_text(f"names: {names[1]}\n")
    recording = load_recording(path, tmp_path / "map.yaml")
    expected = load_recording(write(frame, "right.csv"))
    off = (recording.data["pose"] - expected.data["pose"])[:, 2].numpy()
    assert np.abs(np.remainder(off + np.pi, 2 * np.pi) - np.pi).max() < 0.01


def test_the_right_order_is_accepted_also_where_the_car_drives_straight(straight, write):
    assert load_recording(write(quaternion(straight))).duration > 7.9
    rolled = straight.assign(x=straight.t * 1.0, y=1e-4 * straight.t, yaw=1e-3 * np.sin(straight.t))
    assert load_recording(write(quaternion(rolled.drop(columns=VELOCITY)))).duration > 7.9


@pytest.mark.parametrize("drive", ["good", "straight"])
def test_motion_capture_with_y_up_in_millimetres_is_read_by_following_the_errors(
    drive, request, write, tmp_path
):
    frame = request.getfixturevalue(drive).drop(columns=VELOCITY)
    half = frame.yaw / 2
    # x forward on the floor is z there, y to the left x, and up y: a cyclic exchange.
    table = {"x": 1000 * frame.y, "y": 52.0 + 0 * half, "z": 1000 * frame.x}
    table |= {"qw": np.cos(half), "qx": 0 * half, "qy": np.sin(half), "qz": 0 * half}
    path = write(frame[["t", "throttle", "steering"]].assign(**table))
    message = refused(path)
    names = re.search(r"y is up here: set names: (\{.*?\})", message)
    assert names, message
    file = tmp_path / "map.yaml"
    file.write_text(f"names: {names[1]}\n")
    units = re.search(r"units: (\{x: mm, y: mm\})", refused(path, columns=file))
    file.write_text(f"names: {names[1]}\nunits: {units[1]}\n")
    recording = load_recording(path, load_columns(file))
    truth = load_recording(write(frame, "right.csv"))
    assert np.allclose(recording.data["pose"][:, :2], truth.data["pose"][:, :2], atol=1e-5)
    assert recording.duration == truth.duration


def test_derived_velocities_replace_those_that_are_zero(good, write):
    dead = good.assign(vx=0.0, vy=0.0, yaw_rate=0.0)
    assert "set derive_velocity: true" in refused(write(dead))
    recording = load_recording(write(dead), ColumnMap(derive_velocity=True))
    assert recording.duration > 19.9
    assert recording.data["velocity"][:, 0].max() > 1


def test_a_camera_turned_by_30_degrees_is_told_without_being_asked(good, write):
    turned = good.drop(columns=VELOCITY).assign(yaw=good.yaw + np.radians(30))
    told = telling(load_recording(write(turned)).notes)
    assert [n for n in told if "state mount: {yaw: 0.5" in n]
