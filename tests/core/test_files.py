"""Files that are there as a whole or not at all."""

import json
import re

import pytest
import torch

from buggy_rl.core.files import clear_folder, replacing, save_torch, write_atomically, write_json


def test_what_is_written_is_read_and_nothing_else_is_left(tmp_path):
    write_atomically(tmp_path / "deep" / "text.txt", "µ = 0.8\n")
    write_atomically(tmp_path / "bytes", b"\x00\x01")
    write_json(tmp_path / "table.json", {"seconds": [1.5, None]})
    save_torch(tmp_path / "weights.pt", {"weights": torch.arange(3)})
    assert (tmp_path / "deep" / "text.txt").read_text(encoding="utf-8") == "µ = 0.8\n"
    assert (tmp_path / "bytes").read_bytes() == b"\x00\x01"
    assert json.loads((tmp_path / "table.json").read_text()) == {"seconds": [1.5, None]}
    assert torch.load(tmp_path / "weights.pt")["weights"].tolist() == [0, 1, 2]
    names = {file.name for file in tmp_path.rglob("*") if file.is_file()}
    assert names == {"text.txt", "bytes", "table.json", "weights.pt"}


def test_a_write_that_fails_leaves_the_file_as_it_was(tmp_path):
    file = tmp_path / "table.json"
    write_json(file, [1])
    with pytest.raises(TypeError):
        write_json(file, [object()])
    with pytest.raises(KeyboardInterrupt):
        interrupted(file)
    assert json.loads(file.read_text()) == [1]
    assert [path.name for path in tmp_path.iterdir()] == ["table.json"]


def interrupted(file):
    with replacing(file) as partial:
        partial.write_text("[1, ")
        raise KeyboardInterrupt


def test_files_that_differ_in_their_ending_are_written_side_by_side(tmp_path):
    with replacing(tmp_path / "case.json") as one, replacing(tmp_path / "case.yaml") as other:
        one.write_text("1")
        other.write_text("2")
    assert (tmp_path / "case.json").read_text() == "1"
    assert (tmp_path / "case.yaml").read_text() == "2"


def test_a_folder_is_cleared_of_files_of_ours_or_left_as_it_is(tmp_path):
    own = ["question.yaml", "recordings/drive_*.csv"]
    for name in ("question.yaml", "recordings/drive_0.csv", "recordings/drive_1.csv.partial"):
        write_atomically(tmp_path / "case" / name, "1")
    write_atomically(tmp_path / "case" / "recordings" / "mine.csv", "1")
    with pytest.raises(ValueError, match=r"mine\.csv was not written by what is .*: move it else"):
        clear_folder(tmp_path / "case", own)
    assert len([file for file in tmp_path.rglob("*") if file.is_file()]) == 4
    (tmp_path / "case" / "recordings" / "mine.csv").rename(tmp_path / "mine.csv")
    clear_folder(tmp_path / "case", own)
    assert [file.name for file in tmp_path.iterdir()] == ["mine.csv"]
    clear_folder(tmp_path / "case", own)  # there is none


def test_nothing_takes_whole_folders_away_whatever_is_in_them(repository):
    # Files of the user's own would go with them: `remove_folder` and `clear_folder` know names.
    files = [*(repository / "src").rglob("*.py"), *(repository / "scripts").glob("*.py")]
    assert [f.name for f in files if "rmtree" in f.read_text(encoding="utf-8")] == []


def test_pickles_are_read_from_pipes_and_signed_files_alone(repository):
    source = repository / "src" / "buggy_rl"
    unsafe = {
        file.relative_to(source).as_posix()
        for file in source.rglob("*.py")
        if re.search(r"weights_only=False|pickle\.loads?\(", file.read_text(encoding="utf-8"))
    }
    pipes = {"estimation/workers.py", "visual/film/worker.py"}
    assert unsafe == {"core/files.py", "jobs/call.py", *pipes}
