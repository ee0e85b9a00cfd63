"""Shared diagnoses: computed once for one source and question, and never read for another."""

import os
from dataclasses import replace

import pytest

from buggy_rl.diagnosis.run.stages import Stages
from tests import canned as module
from tests.canned import FORGOTTEN, canned, source_digest
from tests.diagnosis.conftest import SMALL
from tests.diagnosis.planted import planted_drives

QUICK = replace(SMALL, effects=["throttle_gain"], stretches=4)


@pytest.fixture(scope="module")
def recordings():
    return planted_drives([{"throttle_gain": {"gain": 0.7}}], cars=2, seconds=2.0)[0]


def test_any_changed_added_or_renamed_file_of_the_source_is_another_digest(tmp_path):
    (tmp_path / "effects").mkdir()
    file = tmp_path / "effects" / "drag.py"
    file.write_text("RATE = 1\n")
    seen = [source_digest(tmp_path)]
    assert source_digest(tmp_path) == seen[0]
    file.write_text("RATE = 2\n")
    seen.append(source_digest(tmp_path))
    (tmp_path / "calibration.yaml").write_text("price: 3\n")
    seen.append(source_digest(tmp_path))
    file.rename(tmp_path / "effects" / "wind.py")
    seen.append(source_digest(tmp_path))
    assert len(set(seen)) == 4


def test_without_kernels_it_is_another_digest_where_some_are_compiled(monkeypatch, tmp_path):
    monkeypatch.setenv(module.FOLDER, "")
    without = source_digest(tmp_path / "nothing")
    (tmp_path / f"substep-{module.kernel_digest()}.pt2").touch()
    monkeypatch.setenv(module.FOLDER, str(tmp_path))
    assert source_digest(tmp_path / "nothing") != without


def test_it_is_computed_once_for_a_question_and_a_source(recordings, tmp_path, monkeypatch):
    computed = []

    def diagnose(config, recordings, kept):
        """Keeps a number as the diagnosis keeps its stages."""
        stages = Stages(kept, config, recordings)
        return stages.done("answer", lambda: computed.append(1) or len(computed))

    monkeypatch.setattr(module, "run_diagnosis", diagnose)
    assert [canned(tmp_path, QUICK, recordings) for _ in range(2)] == [1, 1]
    assert canned(tmp_path, QUICK, recordings[:1]) == 2
    assert canned(tmp_path, replace(QUICK, seconds=0.9), recordings) == 3
    monkeypatch.setattr(module, "source_digest", lambda: "of other source")
    assert canned(tmp_path, QUICK, recordings) == 4
    monkeypatch.undo()
    monkeypatch.setattr(module, "run_diagnosis", diagnose)
    assert canned(tmp_path, QUICK, recordings) == 1


def test_what_other_source_left_is_removed_after_a_day(recordings, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "run_diagnosis", lambda *_, **__: None)
    for name in ("old", "recent"):
        (tmp_path / name / "stages").mkdir(parents=True)
    old = (tmp_path / "old").stat().st_mtime - 2 * FORGOTTEN
    os.utime(tmp_path / "old", (old, old))
    canned(tmp_path, QUICK, recordings)
    left = {path.name for path in tmp_path.iterdir() if path.is_dir()}
    assert left == {"recent", source_digest()}
