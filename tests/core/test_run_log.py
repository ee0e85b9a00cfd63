"""One log, three places; what TensorBoard and Weights & Biases hold is read from their files."""

import json
import struct
from contextlib import closing

import pytest
import wandb
from PIL import Image
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from buggy_rl.core.run_log import RunLog
from buggy_rl.policies.training.seeds import read_log

BLOCK, WHOLE, LAST = 32768, 1, 4  # bytes of a block, and types of records, of LevelDB's log
ROWS = [{"steps": 10, "reward": 0.5, "waypoints": 3.0}, {"steps": 20, "reward": 0.75}]
ABOUT = {"seed": 3, "ppo": {"clip": 0.2}, "commit": "abc"}


@pytest.fixture
def media(tmp_path):
    frames = [Image.new("RGB", (8, 6), colour) for colour in ("red", "blue")]
    frames[0].save(tmp_path / "path.png")
    frames[0].save(tmp_path / "film.gif", save_all=True, append_images=frames[1:])
    return {"path": tmp_path / "path.png", "film": tmp_path / "film.gif"}


def write(folder, rows, media=None, **options):
    with closing(RunLog(folder, "steps", ABOUT, **options)) as log:
        for row in rows:
            log.add(row, media)
        log.write()


def board(folder):
    found = EventAccumulator(str(folder / "tensorboard"), {"images": 0, "scalars": 0})
    found.Reload()
    return found


def wandb_records(folder):
    """Records of an offline run: a header of 7 bytes, then LevelDB's log format."""
    from wandb.proto.wandb_internal_pb2 import Record

    wandb.teardown()  # on a busy machine finish() returns before the service has written the file
    (file,) = folder.glob("wandb/*run-*/*.wandb")
    content, at, parts = file.read_bytes(), 7, b""
    while at + 7 <= len(content):
        if BLOCK - at % BLOCK < 7:  # no room for a record's head: the block is filled up
            at += BLOCK - at % BLOCK
            continue
        _, length, kind = struct.unpack_from("<IHB", content, at)
        parts += content[at + 7 : at + 7 + length]
        at += 7 + length
        if kind in (WHOLE, LAST):
            yield Record.FromString(parts)
            parts = b""


def wandb_rows(folder):
    records = [r for r in wandb_records(folder) if r.WhichOneof("record_type") == "history"]
    for record in records:
        row = {}
        for item in record.history.item:
            names = list(item.nested_key) or [item.key]
            value = json.loads(item.value_json)
            if len(names) > 1:
                row.setdefault(names[0], {})[names[1]] = value
            else:
                row[names[0]] = value
        yield row


def test_csv_and_tensorboard_hold_the_same_rows(tmp_path):
    write(tmp_path, ROWS)
    events = board(tmp_path)
    assert set(events.Tags()["scalars"]) == {"steps", "reward", "waypoints"}
    for name in ("reward", "waypoints"):
        shown = {event.step: event.value for event in events.Scalars(name)}
        assert read_log(tmp_path, name).to_dict() == shown
    assert read_log(tmp_path, "reward").to_dict() == {10: 0.5, 20: 0.75}


def test_tensorboard_holds_pictures_films_and_the_config(tmp_path, media):
    write(tmp_path, ROWS[:1], media)
    events = board(tmp_path)
    assert set(events.Tags()["images"]) == {"path", "film"}
    (film,) = events.Images("film")
    assert (film.step, film.width, film.height) == (10, 8, 6)
    assert film.encoded_image_string == media["film"].read_bytes()
    assert "clip: 0.2" in str(events.Tensors("config/text_summary")[0].tensor_proto)


def test_weights_and_biases_holds_what_tensorboard_does(tmp_path, media, monkeypatch):
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.setenv("WANDB_SILENT", "true")
    write(tmp_path, ROWS, media, wandb=True)
    rows, tags = list(wandb_rows(tmp_path)), board(tmp_path).Tags()
    assert len(rows) == len(ROWS)  # one a step, not one a metric
    own = {name for row in rows for name in row if not name.startswith("_")} - {"step"}
    assert own == set(tags["scalars"]) | set(tags["images"])
    assert rows[0]["reward"] == 0.5
    assert rows[0]["step"] == 10
    assert rows[0]["path"]["_type"] == "image-file"
    assert rows[0]["film"]["_type"] == "video-file"
    kept = {file.suffix for file in tmp_path.glob("wandb/*run-*/files/media/**/*.*")}
    assert kept == {".png", ".gif"}


def test_weights_and_biases_is_told_how_the_run_was_made(tmp_path, monkeypatch):
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.setenv("WANDB_SILENT", "true")
    write(tmp_path, ROWS, wandb=True)
    (run,) = [r.run for r in wandb_records(tmp_path) if r.WhichOneof("record_type") == "run"]
    config = {item.key: json.loads(item.value_json) for item in run.config.update}
    assert ABOUT.items() <= config.items()
    assert run.project == "buggy_rl"


def test_a_resumed_run_goes_on_in_its_log(tmp_path):
    write(tmp_path, ROWS[:1])
    write(tmp_path, ROWS[1:], resumed_at=10)
    assert list(read_log(tmp_path, "reward").index) == [10, 20]
    assert [event.step for event in board(tmp_path).Scalars("reward")] == [10, 20]


def test_a_resumed_run_goes_on_in_the_same_run_of_weights_and_biases(tmp_path, monkeypatch):
    monkeypatch.setenv("WANDB_MODE", "disabled")
    identities = []
    for resumed_at in (None, 10, None):
        write(tmp_path, ROWS[:1], wandb=True, resumed_at=resumed_at)
        identities.append((tmp_path / "wandb_id.txt").read_text())
    assert identities[0] == identities[1] != identities[2]


def test_a_fresh_run_replaces_the_log_before(tmp_path):
    write(tmp_path, ROWS)
    write(tmp_path, ROWS[:1])
    assert list(read_log(tmp_path, "reward").index) == [10]
    assert [event.step for event in board(tmp_path).Scalars("reward")] == [10]


def test_rows_behind_the_checkpoint_that_a_run_goes_on_from_are_not_there_twice(tmp_path):
    # Killed when the log was written and the checkpoint was not yet, in the middle of a row.
    write(tmp_path, [*ROWS, {"steps": 30, "reward": 1.0}])
    with (tmp_path / "csv" / "scalars" / "reward.csv").open("a") as file:
        file.write("40,1.")
    write(tmp_path, [*ROWS[1:], {"steps": 30, "reward": 1.0}], resumed_at=10)
    text = (tmp_path / "csv" / "scalars" / "reward.csv").read_text()
    assert text == "10,0.5\n20,0.75\n30,1.0\n"
    assert [event.step for event in board(tmp_path).Scalars("reward")] == [10, 20, 30]


def test_files_of_the_users_own_beside_the_log_are_left_alone(tmp_path):
    write(tmp_path, ROWS)
    own = [tmp_path / "csv" / "mine.csv", tmp_path / "csv" / "texts" / "notes.txt"]
    own += [tmp_path / "tensorboard" / "events.out.tfevents.1.mine", tmp_path / "mine.csv"]
    for file in own:
        file.write_text("kept")
    write(tmp_path, ROWS[:1])
    assert [file.read_text() for file in own] == ["kept"] * 4


def test_a_file_of_the_users_own_among_the_metrics_is_refused_by_name(tmp_path):
    own = tmp_path / "csv" / "scalars" / "lap_times.csv"
    own.parent.mkdir(parents=True)
    own.write_text("1,2\n")
    with pytest.raises(ValueError, match=r"lap_times\.csv is no file of a log .*move it elsewhere"):
        write(tmp_path, ROWS)
    assert own.read_text() == "1,2\n"
    own.rename(tmp_path / "lap_times.csv")
    write(tmp_path, ROWS)  # the remedy works


def test_the_log_that_is_there_stays_until_the_first_row_of_another(tmp_path):
    write(tmp_path, ROWS)
    with closing(RunLog(tmp_path, "steps", ABOUT)) as log:
        log.add(ROWS[0])
    assert list(read_log(tmp_path, "reward").index) == [10, 20]


def test_what_is_not_written_is_dropped(tmp_path):
    with closing(RunLog(tmp_path, "steps", ABOUT)) as log:
        log.add(ROWS[0])
        log.write()
        log.add(ROWS[1])
    assert list(read_log(tmp_path, "reward").index) == [10]
