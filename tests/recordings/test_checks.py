"""One fault at a time in a sound recording: each is refused or cut, by row and column."""

import re

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from buggy_rl.recordings import RecordingError, load_recording

POSE = ["x", "y", "yaw"]
VELOCITY = ["vx", "vy", "yaw_rate"]


def at(column, rows, value):
    """A fault: a value, or what a function makes of it, in some rows of a column."""

    def change(frame):
        old = frame[column].to_numpy(float, copy=True)
        old[rows] = value(old[rows]) if callable(value) else value
        return frame.assign(**{column: old})

    return change


def everywhere(column, function):
    return at(column, slice(None), function)


def held(columns, begin, end):
    """A fault: columns repeat row `begin` up to `end` (exclusive)."""

    def change(frame):
        rows = np.arange(len(frame))
        source = np.where((rows >= begin) & (rows < end), begin, rows)
        return frame.assign(**{c: frame[c].to_numpy()[source] for c in columns})

    return change


def without_velocity(change):
    return lambda frame: change(frame).drop(columns=VELOCITY)


def to_world(frame):
    cos, sin = np.cos(frame.yaw), np.sin(frame.yaw)
    vx, vy = cos * frame.vx - sin * frame.vy, sin * frame.vx + cos * frame.vy
    return frame.assign(vx=vx, vy=vy)


def as_quaternion(order="wxyz", length=1.0, bad_row=None):
    """A fault: orientation as a quaternion, wrongly ordered or of another length in one row."""

    def change(frame):
        half = frame.yaw.to_numpy() / 2
        scale = np.ones(len(frame))
        if bad_row is not None:
            scale[bad_row] = length
        parts = {"w": np.cos(half) * scale, "z": np.sin(half) * scale, "x": 0 * half, "y": 0 * half}
        names = dict(zip("wxyz", order, strict=True))
        return frame.drop(columns="yaw").assign(**{f"q{n}": parts[names[n]] for n in "wxyz"})

    return change


REFUSED = {
    "time missing": (at("t", 500, np.nan), 500, "t", "NaN"),
    "time runs back": (at("t", 500, 4.5), 500, "t", "runs back"),
    "time stands still": (at("t", 500, 4.99), 500, "t", "stands still"),
    "time in ms": (everywhere("t", lambda t: 1000 * t), 0, "t", "0.1 Hz"),
    "10 Hz": (lambda f: f.iloc[::10], 0, "t", "10 Hz"),
    "short": (lambda f: f.iloc[:90], 0, "t", "record 1 s or longer"),
    "infinity": (at("y", 500, np.inf), 500, "y", "inf"),
    "command missing": (at("throttle", 500, np.nan), 500, "throttle", "NaN"),
    "a fifth missing": (at("x", slice(500, 900), np.nan), 500, "x", "20%"),
    "text": (lambda f: f.assign(x=f.x.astype(object).where(f.index != 500, "a")), 500, "x", "'a'"),
    "column missing": (lambda f: f.drop(columns="steering"), None, "steering", "throttle"),
    "heading missing": (lambda f: f.drop(columns="yaw"), None, "yaw (or", "column map"),
    "quaternion length": (as_quaternion(length=0.9, bad_row=500), 500, "qw, qx, qy, qz", "0.9"),
    "quaternion zero": (as_quaternion(length=0.0, bad_row=500), 500, "qw, qx, qy, qz", "0.0"),
    "quaternion order": (as_quaternion("xyzw"), None, "qw, qx, qy, qz", "tilt"),
    "yaw in degrees": (everywhere("yaw", np.degrees), None, "yaw", "units: {yaw: deg}"),
    "yaw to the right": (everywhere("yaw", np.negative), None, "yaw", "signs: {yaw: -1}"),
    "yaw turned": (everywhere("yaw", lambda y: y + 2.0), None, "yaw", r"mount: {yaw: 2.0"),
    "yaw in degrees, alone": (
        *(without_velocity(everywhere("yaw", np.degrees)), None, "yaw", "units: {yaw: deg}"),
    ),
    "x and y exchanged": (
        *(without_velocity(lambda f: f.assign(x=f.y, y=f.x, yaw=f.yaw - 2)), None),
        *("yaw", "direction of travel"),
    ),
    "x and y in cm": (lambda f: f.assign(x=100 * f.x, y=100 * f.y), None, "x", "unit of x"),
    "yaw rate in degrees": (everywhere("yaw_rate", np.degrees), None, "yaw_rate", "deg/s"),
    "yaw rate to the right": (
        *(everywhere("yaw_rate", np.negative), None, "yaw_rate", "signs: {yaw_rate: -1}"),
    ),
    "vx backward": (everywhere("vx", np.negative), None, "vx", "signs: {vx: -1}"),
    "vy to the right": (everywhere("vy", np.negative), None, "vy", "signs: {vy: -1}"),
    "vx in km/h": (everywhere("vx", lambda v: 3.6 * v), None, "vx", "times 0.27"),
    "vx dead": (everywhere("vx", lambda v: 0 * v), None, "vx", "disagrees"),
    "world-frame velocity": (to_world, None, "vx", "velocity_frame: world"),
    "vx and vy exchanged": (
        *(lambda f: f.rename(columns={"vx": "vy", "vy": "vx"}), None, "vx", "exchanged"),
    ),
    "throttle beyond full": (at("throttle", 700, 1.7), 700, "throttle", "outside the range"),
    "steering in degrees": (everywhere("steering", lambda s: 30 * s), None, "steering", "range"),
    "frozen throughout": (held([*POSE, *VELOCITY], 0, 2000), 0, "x", "same in all rows"),
    "pose at 10 Hz": (
        *(lambda f: f.assign(**{c: f[c].to_numpy()[f.index // 10 * 10] for c in POSE}),),
        *(0, "t", "10 Hz"),
    ),
}


@pytest.mark.parametrize("fault", REFUSED)
def test_a_recording_with_a_fault_is_refused_by_row_and_column(fault, good, write):
    change, row, column, words = REFUSED[fault]
    path = write(change(good))
    with pytest.raises(RecordingError) as caught:
        load_recording(path)
    line = str(caught.value)
    assert "\n" not in line
    assert re.match(rf"recording {re.escape(str(path))}, (row \d+|all rows), column ", line)
    assert column in caught.value.column
    assert words in line
    if row is not None:
        assert caught.value.row == row


CUT = {
    # fault, row, column, word, rows of the recording that must be missing
    "pose missing": (at("x", slice(500, 503), np.nan), 500, "x", "NaN", 3),
    "velocity missing": (at("vy", 500, np.nan), 500, "vy", "NaN", 1),
    "gap": (lambda f: f.drop(index=range(500, 550)), 500, "t", "rows missing", 50),
    "dropped frame": (lambda f: f.drop(index=500), 500, "t", "rows missing", 1),
    "bunched stamps": (at("t", slice(500, 503), [5.0285, 5.0290, 5.0295]), 500, "t", "late", 3),
    "glitch": (at("y", slice(500, 502), lambda y: y + 0.1), 500, "x", "glitch", 2),
    "yaw glitch": (at("yaw", 500, lambda y: y + 0.5), 500, "yaw", "glitch", 1),
    "teleport": (at("x", slice(500, None), lambda x: x + 1.0), 500, "x", "teleport", 1),
    "small teleport": (at("x", slice(500, None), lambda x: x + 0.05), 500, "x", "teleport", 1),
    "frozen": (held([*POSE, *VELOCITY], 500, 560), 501, "x", "frozen", 59),
    "frozen, pose alone": (without_velocity(held(POSE, 500, 560)), 501, "x", "frozen", 59),
    "speed spike": (at("vx", 500, 30.0), 500, "vx", "spike", 1),
    "yaw rate spike": (at("yaw_rate", 500, -20.0), 500, "yaw_rate", "spike", 1),
    # the car stands 1 m away for 3 s, then goes on from where it would be by then
    "lost": (
        lambda f: f.assign(
            x=np.where((f.index >= 500) & (f.index < 800), f.x[500] + 1 + 1e-6 * f.index, f.x),
            y=np.where((f.index >= 500) & (f.index < 800), f.y[500], f.y),
        ).drop(columns=VELOCITY),
        *(500, "x", "stands still after a teleport", 280),
    ),
}


@pytest.mark.parametrize("fault", CUT)
def test_a_fault_in_one_place_is_cut_and_reported_by_row_and_column(fault, good, write):
    change, row, column, word, rows = CUT[fault]
    recording = load_recording(write(change(good)))
    notes = [note for note in recording.notes if word in note]
    assert len(notes) == 1
    assert re.search(rf"\b{row}\b", notes[0]), notes[0]
    assert f"column {column}: " in notes[0]
    t = recording.data["t"][:, 0].numpy()
    assert recording.data["segment"][-1] >= 1  # the cut separates segments
    missing = 2000 - len(t)
    assert rows <= missing <= rows + 21  # 21: a segment too short to use may go with it
    edges = np.flatnonzero(np.diff(recording.data["segment"]))
    assert (np.diff(t)[edges] > 1.5 * 0.01).all()  # nothing was filled in


SOUND = [
    *[{"rate": rate, "noise": noise} for rate in (20, 50, 100, 200) for noise in (0, 1e-3, 5e-3)],
    *[{"rate": 100, "noise": 1e-3, "jitter": jitter} for jitter in (0.1, 0.25, 0.4)],
]


@pytest.mark.parametrize("velocity", ["measured", "derived"])
@pytest.mark.parametrize("options", SOUND, ids=str)
def test_noise_jitter_and_slow_rates_trip_no_check(options, velocity, make_drive, write):
    frame = make_drive(**options)
    if velocity == "derived":
        frame = frame.drop(columns=VELOCITY)
    recording = load_recording(write(frame))
    assert [note for note in recording.notes if "derived" not in note] == []
    assert recording.duration > 19.9  # [s] of 20


def test_a_hard_stop_against_a_wall_is_no_glitch(make_drive, write):
    frame = make_drive(noise=2e-4).drop(columns=VELOCITY)
    noise = 2e-4 * np.random.default_rng(1).standard_normal((1000, 2))
    frame.loc[1000:, ["x", "y"]] = frame.loc[999, ["x", "y"]].to_numpy(float) + noise
    frame.loc[1000:, "yaw"] = frame.yaw[999]
    assert load_recording(write(frame)).duration > 19.9


def test_a_noise_free_car_at_rest_is_not_frozen(make_drive, write):
    frame = make_drive()
    rest = frame.iloc[[0] * 300].assign(t=np.arange(300) * 0.01)
    frame["t"] += 3.0
    path = write(pd.concat([rest, frame]))
    assert load_recording(path).duration == pytest.approx(23.0, abs=0.02)


def test_a_lever_arm_or_a_small_mounting_error_is_no_disagreement(good, write):
    frame = good.assign(yaw=good.yaw + 0.05, vy=good.vy + 0.1 * good.yaw_rate)
    assert load_recording(write(frame)).duration > 19.9


def delayed(columns, rows):
    return lambda frame: frame.assign(**{c: frame[c].shift(rows).bfill().ffill() for c in columns})


@pytest.mark.parametrize(
    "flaw",
    [
        delayed(VELOCITY, 15),
        delayed(VELOCITY, -15),
        everywhere("vx", lambda v: 1.25 * v),
        everywhere("yaw_rate", lambda r: r + 0.15),
        lambda frame: frame.assign(**frame[VELOCITY].rolling(20, min_periods=1).mean()),
    ],
    ids=["late 0.15 s", "early 0.15 s", "speed 25 % high", "gyro bias", "past mean of 0.2 s"],
)
def test_an_error_that_the_diagnosis_estimates_is_left_in(flaw, make_drive, write):
    frame = make_drive(noise=2e-4, agility=3.0)
    recording = load_recording(write(flaw(frame)))
    assert recording.duration > 19.9
    expected = flaw(frame)[VELOCITY].to_numpy(np.float32)
    assert np.allclose(recording.data["velocity"], expected, atol=1e-5)


def test_a_late_velocity_is_noted(make_drive, write):
    frame = make_drive(noise=2e-4, agility=3.0)
    late = load_recording(write(delayed(VELOCITY, 15)(frame)))
    (note,) = [note for note in late.notes if "yaw_rate: agrees with the pose only if" in note]
    assert note.split(",")[0].endswith("late")
    assert load_recording(write(frame)).notes == []


def test_a_velocity_that_is_half_a_second_late_is_refused(make_drive, write):
    frame = delayed(VELOCITY, 50)(make_drive(noise=2e-4, agility=3.0))
    with pytest.raises(RecordingError, match="disagrees with"):
        load_recording(write(frame))


def test_a_velocity_that_sticks_is_refused_where_it_sticks(good, write):
    with pytest.raises(RecordingError, match="disagrees with") as caught:
        load_recording(write(at("vx", slice(600, 1100), 0.7)(good)))
    assert caught.value.column == "vx"
    assert 600 <= caught.value.row < 1100


def test_a_short_disagreement_is_cut_around_its_rows(make_drive, write):
    frame = make_drive(seconds=60, noise=2e-4)
    recording = load_recording(write(at("vx", slice(2000, 2030), lambda v: v + 3)(frame)))
    (note,) = [note for note in recording.notes if "disagrees with the pose" in note]
    begin, end = map(int, re.match(r"rows (\d+)-(\d+), column vx", note).groups())
    assert 1950 <= begin < 2000
    assert 2030 < end <= 2080
    assert recording.duration > 58.5


def test_a_car_that_never_moves_is_noted(make_drive, write):
    frame = make_drive(noise=2e-4)
    still = frame.assign(x=1 + 1e-4 * np.sin(frame.t), y=0, yaw=0, vx=0, vy=0, yaw_rate=0)
    assert "never moves" in " ".join(load_recording(write(still)).notes)


def test_a_mounting_error_is_noted(good, write):
    notes = load_recording(write(good.assign(yaw=good.yaw + 0.2))).notes
    (note,) = [note for note in notes if "mount" in note]
    assert float(re.search(r"yaw: (-?[\d.]+)", note)[1]) == pytest.approx(0.2, abs=0.02)
    assert not [note for note in load_recording(write(good)).notes if "mount" in note]


def test_steering_to_the_wrong_side_is_noted(good, write):
    wrong = load_recording(write(good.assign(steering=-good.steering)))
    assert [note for note in wrong.notes if "steering left turns the car right" in note]
    assert not [note for note in load_recording(write(good)).notes if "turns the car" in note]


def test_a_throttle_that_rests_at_zero_is_noted(good, write):
    half = load_recording(write(good.assign(throttle=(good.throttle + 1) / 2)))
    assert [note for note in half.notes if "rest: 0" in note]


def test_a_pose_slower_than_the_rows_keeps_its_own_rows(good, write):
    slow = {c: good[c].to_numpy()[good.index // 4 * 4] for c in POSE}  # 25 Hz in rows of 100 Hz
    recording = load_recording(write(good.assign(**slow)))
    assert [note for note in recording.notes if "75% repeat it" in note]
    assert recording.duration > 19.9
    assert recording.data["segment"].max() == 0


@settings(max_examples=25, deadline=None)
@given(
    row=st.integers(30, 1900),
    column=st.sampled_from(["x", "y", "yaw", "vx", "vy", "yaw_rate"]),
    size=st.one_of(st.floats(4.0, 1e4), st.floats(-1e4, -4.0)),
)
def test_no_single_outlier_reaches_the_recording(row, column, size, make_drive, tmp_path_factory):
    frame = at(column, row, lambda value: value + size)(make_drive(noise=2e-4, seconds=20))
    if column == "yaw":  # on the circle 2 pi is no leap
        frame.loc[row, "yaw"] = make_drive(noise=2e-4).yaw[row] + 0.3 + 0.5 * (abs(size) % 5)
    path = tmp_path_factory.mktemp("outlier") / "drive.csv"
    frame.to_csv(path, index=False)
    recording = load_recording(path)
    assert [note for note in recording.notes if re.match(rf"row {row}, ", note)]
    t = recording.data["t"][:, 0].numpy()
    assert np.abs(t - frame.t[row]).min() > 0.005
    assert recording.duration > 19.5
