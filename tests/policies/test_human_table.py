"""The human's row, from drives that are in a folder."""

from dataclasses import replace

import pytest

from buggy_rl.core.config import plain_values
from buggy_rl.core.files import write_json
from buggy_rl.policies.human_table import DriveNote, HumanDrives, human_drives, human_lines

SIMULATORS = {"learned": "runs/model.pt", "mujoco": "runs/fitted.yaml"}
NOTE = DriveNote(
    "human", "keyboard", "runs/fitted.yaml", "lap", 0, "2030-01-01T12:00:00+00:00", 10.0,
    finished=True, seconds=10.0, waypoints=61,
)  # fmt: skip


def written(folder, **notes):
    """A folder with a recording and its note for each name."""
    for name, note in notes.items():
        (folder / f"{name}.csv").touch()
        if note is not None:
            write_json(folder / f"{name}.json", plain_values(note))
    return human_drives(folder, SIMULATORS)


def test_the_mean_of_a_persons_drives_fills_the_row(tmp_path):
    found = written(tmp_path, a=NOTE, b=replace(NOTE, waypoints=71))
    assert "| human | lap | - (58.3) | 66.0 ± 5.0 (68.7) |" in human_lines(found, list(SIMULATORS))


def test_a_scripted_driver_that_stood_in_is_marked(tmp_path):
    lines = human_lines(written(tmp_path, a=replace(NOTE, driver="scripted")), list(SIMULATORS))
    assert "| human (scripted driver) | lap | - (58.3) | 61.0 ± 0.0 (68.7) |" in lines


def test_a_person_replaces_the_scripted_driver_of_a_path(tmp_path):
    found = written(tmp_path, a=replace(NOTE, driver="scripted", waypoints=99), b=NOTE)
    text = "\n".join(human_lines(found, list(SIMULATORS)))
    assert "61.0" in text
    assert "scripted" not in text
    assert "99" not in text


def test_without_drives_the_row_is_left_out(tmp_path):
    expected = ["", "Table 7.4: the human driver's row is left for a person to drive."]
    assert human_lines(human_drives(tmp_path / "none", SIMULATORS), ["learned"]) == expected
    assert human_lines(HumanDrives(), ["learned"]) == expected


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"finished": False}, "broken off"),
        ({"course": "none", "limit": 60.0}, "course 'none'"),
        ({"limit": 20.0}, "it may last 20 s, the table's drives 10 s"),
        ({"simulator": "kinematic"}, "simulator 'kinematic' is not in the table"),
        ({"slipped": 3.0}, "slow motion"),
        ({"driver": "robot"}, "neither human nor scripted"),
    ],
)
def test_a_drive_of_another_kind_is_left_out_with_the_reason(tmp_path, change, reason):
    found = written(tmp_path, a=replace(NOTE, **change))
    assert found.waypoints == {}
    assert reason in human_lines(found, list(SIMULATORS))[-1]
    assert "a.csv" in found.left_out[0]


def test_a_recording_without_a_note_is_named(tmp_path):
    assert written(tmp_path, a=None).left_out == ["a.csv: there is no a.json that says who drove"]


def test_a_note_that_is_none_is_refused(tmp_path):
    (tmp_path / "a.csv").touch()
    (tmp_path / "a.json").write_text("[]")
    with pytest.raises(ValueError, match=r"a\.json"):
        human_drives(tmp_path, SIMULATORS)
