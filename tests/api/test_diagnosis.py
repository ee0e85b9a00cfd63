"""A diagnosis asked in Python: the same as from the command line, and what can be done with it."""

import runpy
import sys
from pathlib import Path

import pytest
import torch

import buggy_rl
from buggy_rl.core import keys
from buggy_rl.core.config import ConfigError
from tests.diagnosis.planted import planted_drives

SETTINGS = {
    "effects": ["throttle_gain"],
    "parameters": False,
    "stretches": 8,
    "minutes": 0,  # however busy the machine is, the same search
    "workers": 1,
}


@pytest.fixture(scope="module")
def drives(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("drives")
    for recording in planted_drives([{"throttle_gain": {"gain": 0.7}}], seconds=6.0)[0]:
        buggy_rl.save_recording(recording, folder / f"{recording.name}.csv")
    return folder


@pytest.fixture(scope="module")
def found(drives: Path) -> buggy_rl.Diagnosis:
    recordings, refused = buggy_rl.load_recordings(drives)
    assert not refused
    return buggy_rl.diagnose(recordings, simulator="single_track", **SETTINGS)


@pytest.fixture(scope="module")
def saved(found: buggy_rl.Diagnosis, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("saved")
    assert {file.name for file in found.save(folder)} == {file.name for file in folder.iterdir()}
    return folder


@pytest.mark.slow
def test_the_command_line_writes_the_same_answer(saved, drives, tmp_path, monkeypatch, repository):
    words = [f"{name}={value}" for name, value in SETTINGS.items() if name != "effects"]
    words += [f"effects=[{','.join(SETTINGS['effects'])}]", f"output={tmp_path}"]
    command = ["scripts/diagnose.py", "simulator=single_track", f"recordings={drives}", *words]
    monkeypatch.setattr(sys, "argv", command)
    runpy.run_path(str(repository / "scripts" / "diagnose.py"), run_name="__main__")
    for name in ("diagnosis.json", "repaired.yaml"):
        assert (tmp_path / name).read_bytes() == (saved / name).read_bytes()


def test_it_names_what_was_planted_in_words_and_in_a_table(found):
    assert found.verdict == "missing_physics"
    first = found.effects.iloc[0]
    assert (first.effect, first.parameter) == ("throttle_gain", "gain")
    assert first.low < first.value < first.high
    assert first.value == pytest.approx(0.7, abs=0.06)
    assert found.fit["after"] < found.fit["before"]
    assert str(found).splitlines() == found.lines
    assert found.to_dict()["effects"][0]["name"] == "throttle_gain"


def test_the_repaired_simulator_is_that_of_its_file_and_not_the_given_one(found, saved):
    def end(engine):
        state = engine.reset()
        for _ in range(50):
            state = engine.step(state.set(keys.ACTION, torch.full((2, 2), 0.3)))["next"]
        return state[keys.POSE]

    here = end(found.repaired(2))
    assert torch.equal(here, end(buggy_rl.make_simulator(saved / "repaired.yaml", 2)))
    assert not torch.allclose(here, end(buggy_rl.make_simulator("single_track", 2)), atol=1e-2)


def test_a_notebook_shows_sentences_table_and_picture(found):
    shown = found._repr_html_()
    assert "throttle_gain" in shown
    assert "<svg" in shown
    assert "<table" in shown


def test_the_report_alone_is_one_page_that_says_what_asked_for_it(found, tmp_path):
    page = found.report(tmp_path / "page.html").read_text()
    assert "buggy_rl.diagnose(" in page
    assert [file.name for file in tmp_path.iterdir()] == ["page.html"]


def test_a_misspelt_setting_is_refused_before_anything_is_read():
    with pytest.raises(ConfigError, match=r"^diagnose: .*'efects'; did you mean 'effects'"):
        buggy_rl.diagnose("nowhere", simulator="single_track", efects=["wind"])


def test_recordings_that_are_not_there_are_said(tmp_path):
    with (
        pytest.warns(UserWarning, match=r"refused: .*nowhere\.csv"),
        pytest.raises(ValueError, match="no drive is left"),
    ):
        buggy_rl.diagnose(tmp_path / "nowhere.csv", simulator="single_track")


def test_a_factory_is_a_simulator_that_can_be_repaired_but_not_written(found, tmp_path):
    from dataclasses import replace

    given = replace(found.config, simulator=lambda n, device: buggy_rl.make_engine("kinematic", n))
    own = replace(found, config=given)
    with pytest.raises(ValueError, match=r"is an object, which repaired\.yaml cannot name"):
        own.save(tmp_path)
    assert own.repaired(3).batch_size == (3,)
    assert not list(tmp_path.iterdir())
