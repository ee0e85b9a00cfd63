"""Tables in text as spreadsheets, loggers and other languages write them."""

import json

import numpy as np
import pandas as pd
import pytest

from buggy_rl.recordings import ColumnMap, RecordingError, load_recording
from buggy_rl.recordings.columns import load_columns
from buggy_rl.recordings.readers.csv_parquet import read_csv
from tests.recordings.test_readers import refusal, same_drive

SECONDS = 4.0


@pytest.fixture
def frame(make_drive):
    return make_drive(seconds=SECONDS, noise=2e-4).round(6)


@pytest.fixture
def save(tmp_path):
    """Writes text in an encoding and returns its path."""

    def write(text: str, encoding: str = "utf-8", name: str = "drive.csv"):
        (tmp_path / name).write_bytes(text.encode(encoding))
        return tmp_path / name

    return write


def european(frame, separator=";"):
    return frame.to_csv(index=False, sep=separator, decimal=",", lineterminator="\r\n")


def quoted(frame):
    header, *lines = european(frame).splitlines()
    rows = [",".join(f'"{cell}"' for cell in line.split(";")) for line in lines]
    return "\n".join([header.replace(";", ","), *rows, ""])


def plain(frame, **options):
    return frame.to_csv(index=False, **options)


FILES = {
    "semicolons and decimal commas": (european, "utf-8-sig"),
    "tabs and decimal commas in UTF-16": (lambda f: european(f, "\t"), "utf-16"),
    "UTF-16 without a mark": (plain, "utf-16-le"),
    "decimal commas in quotes": (quoted, "utf-8"),
    "spaces": (lambda f: plain(f, sep=" "), "utf-8"),
    "a line that states the separator": (lambda f: "sep=;\r\n" + plain(f, sep=";"), "utf-8"),
    "a name in Latin-1": (lambda f: plain(f.assign(größe=1.0)), "latin-1"),
    "comments above and between": (
        lambda f: "# a drive\n# of mine\n" + plain(f).replace("\n1.", "\n# second 1\n1.", 1),
        "utf-8",
    ),
    "names in a comment": (lambda f: "# " + plain(f), "utf-8"),
    "names as rostopic writes them": (lambda f: "%" + plain(f), "utf-8"),
    "a line of units": (
        lambda f: plain(f).replace("\n", "\ns,m,m,rad,m/s,m/s,rad/s,,\n", 1),
        "utf-8",
    ),
    "an export's preamble": (lambda f: "Version,1.23,Take,one\n\n" + plain(f), "utf-8"),
    "capitals": (lambda f: plain(f.rename(columns=str.upper)), "utf-8"),
    "line ends of old": (lambda f: plain(f, lineterminator="\r"), "utf-8"),
}


@pytest.mark.parametrize("kind", FILES)
def test_a_table_in_text_is_read_whoever_wrote_it(kind, frame, save):
    make, encoding = FILES[kind]
    same_drive(load_recording(save(make(frame), encoding)), frame)


def test_thousands_are_not_taken_for_decimals(frame, save):
    path = save(plain(frame.assign(x=frame.x.map(lambda x: "1,234"))))
    error = refusal(path)
    assert (error.row, error.column) == (0, "x")
    assert "'1,234' is not a number" in str(error)


def test_rows_count_from_the_header_as_an_editor_does(frame, save):
    path = save("# one\n# two\n" + plain(frame.assign(x=frame.x.where(frame.index != 30, np.inf))))
    assert refusal(path).row == 30
    text = plain(frame).splitlines()
    text[31:31] = ["# between"]  # before row 30, which is on line 33 now
    path = save("\n".join(text).replace(text[32], text[32].replace(",", ",a", 1)) + "\n")
    assert refusal(path).row == 31


STAMPS = {
    "ISO 8601": lambda t: (pd.Timestamp("2024-09-06T18:31:44") + t).map(pd.Timestamp.isoformat),
    "with a zone": lambda t: (pd.Timestamp("2024-09-06T18:31:44+02:00") + t).astype(str),
    "day first": lambda t: (pd.Timestamp("2024-09-06T18:31:44") + t).dt.strftime(
        "%d.%m.%Y %H:%M:%S.%f"
    ),
    "time of day": lambda t: (pd.Timestamp("2024-09-06T18:31:44") + t).dt.strftime("%H:%M:%S.%f"),
}


@pytest.mark.parametrize("kind", STAMPS)
def test_stamps_may_be_dates_or_times_of_day(kind, frame, save):
    t = STAMPS[kind](pd.to_timedelta(frame.t, unit="s"))
    recording = load_recording(save(plain(frame.assign(t=t))))
    same_drive(recording, frame)
    seconds = recording.data["t"][:, 0].numpy()
    assert seconds - seconds[0] == pytest.approx(frame.t.to_numpy(), abs=1e-6)


def test_a_stamp_that_is_no_date_is_refused_by_its_row(frame, save):
    t = STAMPS["ISO 8601"](pd.to_timedelta(frame.t, unit="s")).where(frame.index != 70, "later")
    error = refusal(save(plain(frame.assign(t=t))))
    assert (error.row, error.column) == (70, "t")


@pytest.mark.parametrize("zone", ["UTC", "Europe/Berlin"])
def test_dates_with_a_zone_in_parquet_are_seconds(zone, frame, tmp_path):
    start = pd.Timestamp("2024-09-06T18:31:44", tz="UTC")
    t = (start + pd.to_timedelta(frame.t, unit="s")).dt.tz_convert(zone)
    frame.assign(t=t).to_parquet(tmp_path / "drive.parquet")
    recording = load_recording(tmp_path / "drive.parquet")
    same_drive(recording, frame)
    assert recording.data["t"][0] == pytest.approx(start.timestamp(), abs=1e-6)


def test_a_table_without_a_header_is_named_by_position(frame, save, tmp_path):
    path = save(plain(frame, header=False))
    assert read_csv(path).headerless
    assert list(read_csv(path).columns) == [str(i) for i in range(9)]
    assert "no header line, columns by their position: 0 to 8" in str(refusal(path))
    (tmp_path / "map.yaml").write_text(
        "names: {t: 0, x: 1, y: 2, yaw: 3, vx: 4, vy: 5, yaw_rate: 6, throttle: 7, steering: 8}\n"
    )
    same_drive(load_recording(path, tmp_path / "map.yaml"), frame)


def test_a_first_row_with_one_cell_is_no_line_of_units(frame, save):
    frame.loc[0, frame.columns[1:-2]] = np.nan
    frame.loc[0, "x"] = frame.x[1]
    table = read_csv(save(plain(frame)))
    assert len(table) == len(frame)
    assert table.notes == []


def test_names_that_are_numbers_are_names(frame, save):
    path = save(plain(frame.set_axis([str(i) for i in range(9)], axis=1)))
    assert not read_csv(path).headerless
    assert len(read_csv(path)) == len(frame)


def test_tables_of_topics_without_headers_are_one_drive(frame, tmp_path):
    """What `ros2 topic echo --csv` writes, of an odometry and a command topic."""
    folder = tmp_path / "drive"
    folder.mkdir()
    seconds = 1_725_647_507 + frame.t // 1
    parts = {"sec": seconds.astype(int), "ns": (frame.t % 1 * 1e9).round().astype(int)}
    half, zero = frame.yaw / 2, 0 * frame.t
    pose = {"f": "odom", "c": "base", "x": frame.x, "y": frame.y, "z": zero, "qx": zero}
    pose |= {"qy": zero, "qz": np.sin(half), "qw": np.cos(half)}
    pd.DataFrame({**parts, **pose}).to_csv(folder / "odom.csv", header=False, index=False)
    drive = {"f": "", "u": frame.throttle, "s": frame.steering}
    pd.DataFrame({**parts, **drive}).to_csv(folder / "drive.csv", header=False, index=False)
    (tmp_path / "map.yaml").write_text(
        "tables: [{file: odom.csv, time: {0: s, 1: ns}}, {file: drive.csv, time: {0: s, 1: ns}}]\n"
        "names: {x: odom.4, y: odom.5, qx: odom.7, qy: odom.8, qz: odom.9, qw: odom.10,\n"
        "        throttle: drive.3, steering: drive.4}\n"
    )
    recording = load_recording(folder, tmp_path / "map.yaml")
    assert recording.duration == pytest.approx(SECONDS, abs=0.02)
    assert np.allclose(recording.data["action"], frame[["throttle", "steering"]], atol=1e-5)
    assert "odom.csv: no header line" in recording.notes[0]


def test_a_header_in_the_middle_begins_a_segment(frame, save):
    lines = plain(frame).splitlines()
    recording = load_recording(save("\n".join([*lines[:201], lines[0], *lines[201:], ""])))
    assert [n for n in recording.notes if "row 200: the header again, two files joined" in n]
    assert recording.data["segment"].max() == 1
    assert recording.duration == pytest.approx(SECONDS, abs=0.02)


def test_two_files_joined_each_with_its_own_clock_are_two_segments(frame, save):
    recording = load_recording(save(plain(frame) + plain(frame)))
    assert recording.data["segment"].max() == 1
    assert recording.duration == pytest.approx(2 * SECONDS, abs=0.03)
    assert (recording.data["t"].diff(dim=0) > 0).all()
    assert [n for n in recording.notes if "set back by 4 s" in n]


def test_a_block_of_zero_bytes_is_cut_and_said(frame, save):
    lines = plain(frame).splitlines()
    lines[200] = lines[200][:20] + "\0" * 512 + lines[203][10:]
    recording = load_recording(save("\n".join([*lines[:201], *lines[204:], ""])))
    assert "row 199: 512 zero bytes, as a power cut leaves them: cut" in recording.notes[0]
    assert recording.data["segment"].max() == 1
    t = recording.data["t"][:, 0].numpy()
    assert not ((t > 1.985) & (t < 2.025)).any()


def test_what_is_no_text_is_refused(tmp_path):
    (tmp_path / "drive.csv").write_bytes(bytes(range(1, 200)) * 20)
    assert "not text in UTF-8, UTF-16 or Latin-1" in str(refusal(tmp_path / "drive.csv"))


def json_lines(frame, change=lambda row: row):
    return "".join(json.dumps(change(row)) + "\n" for row in frame.to_dict("records"))


@pytest.mark.parametrize("ending", ["jsonl", "ndjson"])
def test_json_lines_are_read(ending, frame, save):
    same_drive(load_recording(save(json_lines(frame), name=f"drive.{ending}")), frame)


def test_what_is_nested_in_json_lines_is_named_by_its_path(frame, save, tmp_path):
    def nested(row):
        return {"t": row["t"], "pose": {k: row[k] for k in ("x", "y", "yaw")}, "axes": [
            row["steering"], row["throttle"]]}  # fmt: skip

    text = "names: {x: pose.x, y: pose.y, yaw: pose.yaw, steering: 'axes[0]', throttle: 'axes[1]'}"
    (tmp_path / "map.yaml").write_text(text)
    path = save(json_lines(frame, nested), name="drive.jsonl")
    recording = load_recording(path, load_columns(tmp_path / "map.yaml"))
    assert np.allclose(recording.data["action"], frame[["throttle", "steering"]], atol=1e-6)


def test_a_line_of_json_that_is_cut_off_is_left_out_and_a_broken_one_refused(frame, save):
    text = json_lines(frame)
    recording = load_recording(save(text[:-30], name="drive.jsonl"))
    assert len(recording) == len(frame) - 1
    assert "row 399, all columns: the file is cut off" in recording.notes[0]
    lines = text.splitlines()
    lines[100] = lines[100][:-1]
    assert refusal(save("\n".join(lines), name="drive.jsonl")).row == 100
    lines[100] = "[1, 2]"
    assert "is no object" in str(refusal(save("\n".join(lines), name="drive.jsonl")))
    assert "empty" in str(refusal(save("\n", name="drive.jsonl")))


def test_one_column_as_both_commands_is_refused(frame, save):
    path = save(plain(frame))
    with pytest.raises(RecordingError, match="throttle and steering are the same numbers"):
        load_recording(path, ColumnMap(names={"throttle": "steering"}))
    with pytest.raises(RecordingError, match="throttle and steering are the same numbers"):
        load_recording(save(plain(frame.assign(steering=frame.throttle))))
