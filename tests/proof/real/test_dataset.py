"""Halves of a dataset have nothing in common, by name and by content."""

import shutil
from dataclasses import replace

import pytest
import torch

from buggy_rl.core import keys
from buggy_rl.proof.real.dataset import (
    DatasetConfig,
    cut_pieces,
    halves,
    load_dataset,
    refuse_copies,
)
from tests.proof.real.plant import commands, recording


def test_halves_share_nothing_leave_nothing_out_and_have_each_kind_of_drive(dataset):
    for partition in (0, 1):
        sides = halves(dataset.recordings, partition)
        names = [{r.name for r in side} for side in sides.values()]
        assert not names[0] & names[1]
        assert names[0] | names[1] == {r.name for r in dataset.recordings}
        for side in sides.values():
            assert sorted(r.source.rsplit("/")[-2] for r in side) == ["fast", "slow"]


def test_no_division_is_made_twice(dataset):
    first, second = (halves(dataset.recordings, n)["a"] for n in (0, 1))
    assert 0 < len({r.name for r in first} & {r.name for r in second}) < 2
    # Two kinds of two drives each can be divided in two ways.
    with pytest.raises(ValueError, match="divided in 2 ways, not in 3"):
        halves(dataset.recordings, 2)


def test_a_half_is_found_by_its_name(dataset):
    sides = halves(dataset.recordings, 1)
    assert [r.name for r in dataset.half("1b")] == [r.name for r in sides["b"]]


def test_a_copy_under_another_name_and_other_stamps_is_refused(dataset):
    one = dataset.recordings[0]
    copy = replace(one, name="another", source="elsewhere/another.csv", data=one.data[300:].clone())
    copy.data[keys.TIME] -= 3.0
    with pytest.raises(ValueError, match=r"drive_\d.csv and elsewhere/another.csv have 600 of 600"):
        refuse_copies([*dataset.recordings, copy])
    refuse_copies(dataset.recordings)


def test_cars_at_rest_are_no_copies_of_one_another():
    rest = torch.tensor([[-1.0, 0.0]]).expand(50, 2)
    refuse_copies([recording(rest, "one"), recording(rest, "other")])


def test_what_is_refused_or_not_there_is_said(drives, tmp_path):
    with pytest.raises(ValueError, match=r"small.leave_out: no recordings \['drive_9'\]; there"):
        load_dataset("small", DatasetConfig([str(drives)], car="buggy", leave_out=["drive_9"]))
    (tmp_path / "drive.csv").write_text("t,x\n0,0\n")
    with pytest.raises(ValueError, match=r"datasets\.small: recording .*drive\.csv"):
        load_dataset("small", DatasetConfig([str(tmp_path)], car="buggy"))
    kept = load_dataset("small", DatasetConfig([str(drives)], car="buggy", leave_out=["drive_0"]))
    assert [r.name for r in kept.recordings] == ["drive_1", "drive_3", "drive_2"]


def test_copied_files_are_refused(drives, tmp_path):
    shutil.copytree(drives, tmp_path / "all")
    shutil.copy(tmp_path / "all" / "slow" / "drive_0.csv", tmp_path / "all" / "again.csv")
    with pytest.raises(ValueError, match="rows in common"):
        load_dataset("small", DatasetConfig([str(tmp_path / "all")], car="buggy"))


def test_pieces_are_the_recording_in_order():
    drive = recording(commands(250))
    made = list(cut_pieces([drive, drive], 1.0))
    assert [piece.name for piece in made] == [f"piece_{n:03d}" for n in range(6)]
    assert max(len(piece) for piece in made) <= 100
    joined = torch.cat([piece.data[keys.POSE] for piece in made[:3]])
    assert torch.equal(joined, drive.data[keys.POSE])


@pytest.mark.slow
def test_the_real_recordings_have_no_copies(dart_folder, frictionmaps_folder, repository):
    for name, folder in (("dart", dart_folder), ("frictionmaps", frictionmaps_folder)):
        columns = str(repository / "configs" / "columns" / f"{name}.yaml")
        found = load_dataset(name, DatasetConfig([str(folder)], columns, name))
        assert len(found.recordings) == {"dart": 31, "frictionmaps": 5}[name]
