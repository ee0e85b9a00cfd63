"""Known changes: which recordings, what is measured of them, and what counts as right."""

import json

import pytest
import yaml

from buggy_rl.core import keys
from buggy_rl.core.config import from_command_line
from buggy_rl.core.files import write_atomically, write_json
from buggy_rl.jobs import OUTCOME
from buggy_rl.proof.cases.sealing import CaseStore
from buggy_rl.proof.real import measures
from buggy_rl.proof.real.known import (
    KnownChange,
    KnownConfig,
    KnownResult,
    chosen_recordings,
    id_of,
    known_job,
    known_results,
    write_known,
)
from buggy_rl.proof.real.measures import MEASURES
from buggy_rl.proof.real.preparing import simulator_file
from buggy_rl.proof.real.sealing import QuestionConfig
from buggy_rl.proof.score.outcome import CaseAnswer, ScoredEffect
from buggy_rl.recordings import load_recordings

CHANGES = {
    "fast": KnownChange("driven by another", ["drive_0"], ["drive_1"], ["throttle_gain"]),
    "same": KnownChange("", ["drive_2@0:4.5"], ["drive_2@4.5:"]),
}


@pytest.fixture
def written(tmp_path, dataset, config, monkeypatch):
    monkeypatch.setattr(measures, "LEAST", 1)  # drives are short
    store = CaseStore(tmp_path / "open", tmp_path / "safe")
    asked = KnownConfig(config, ["drive_3"], changes=CHANGES)
    file = simulator_file(store.prepared, dataset.name, "fitted", "single_track")
    write_atomically(file, yaml.safe_dump({"engine": "single_track"}))
    assert write_known(store, dataset, asked, QuestionConfig()) == ["known_fast", "known_same"]
    return store, asked


def test_a_part_of_a_recording_is_named_by_its_seconds(dataset):
    whole, first, rest = chosen_recordings(dataset, ["drive_2", "drive_2@0:4.5", "drive_2@4.5:"])
    assert (len(whole), len(first), len(rest)) == (900, 450, 450)
    assert float(rest.data[keys.TIME][0, 0]) == pytest.approx(4.5)


@pytest.mark.parametrize(
    ("name", "said"),
    [("drive_9", "no recording 'drive_9'; available: drive_0"), ("drive_0@30:", "nothing in 30:")],
)
def test_what_is_not_there_is_said(dataset, name, said):
    with pytest.raises(ValueError, match=said):
        chosen_recordings(dataset, [name])


def test_both_sides_are_written_and_measured(written):
    store, _ = written
    folder = store.inputs(id_of("same"))
    for part in ("recordings", "baseline"):
        [found], refusals = load_recordings([str(folder / part)], folder / "columns.yaml")
        assert (len(found), refusals) == (450, [])
    whole = json.loads((store.output / "known" / "fast.json").read_text())
    assert {m["name"] for m in whole} <= {*MEASURES}
    assert whole


def test_what_was_written_stays(written, dataset):
    store, asked = written
    before = {f: f.stat().st_mtime_ns for f in store.output.rglob("*") if f.is_file()}
    write_known(store, dataset, asked, QuestionConfig())
    assert {f: f.stat().st_mtime_ns for f in before} == before
    assert known_job(store, dataset, asked, store.output) == {}


def test_a_recording_on_both_sides_is_refused(tmp_path, dataset, config):
    store = CaseStore(tmp_path / "open", tmp_path / "safe")
    both = KnownConfig(config, changes={"both": KnownChange("", ["drive_0"], ["drive_0@2:6"])})
    with pytest.raises(ValueError, match="rows in common"):
        write_known(store, dataset, both, QuestionConfig())


def test_answers_stand_beside_what_was_measured(written):
    store, asked = written
    folder = store.diagnosis(id_of("fast"))
    effect = {"name": "throttle_gain", "confidence": 0.7}
    write_json(folder / "diagnosis.json", {"verdict": "missing_physics", "effects": [effect]})
    write_json(folder / OUTCOME, {"status": "done", "seconds": 1.0, "last_words": ""})
    fast, same = known_results(store, asked.changes)
    assert fast.right
    assert fast.measured
    assert (same.answer, same.right) == (None, None)


def test_what_is_right_of_a_change_and_of_none():
    sure, unsure = (
        CaseAnswer("missing_physics", (ScoredEffect("tire_grip", p),)) for p in (0.8, 0.4)
    )
    changed, none = KnownChange("tape", effects=["tire_grip"]), KnownChange()
    said = [
        KnownResult("", change, [], answer).right
        for change in (changed, none)
        for answer in (sure, unsure)
    ]
    assert said == [True, False, False, True]


def test_a_right_name_after_a_wrong_one_is_not_right():
    both = tuple(ScoredEffect(name, p) for name, p in (("payload", 0.9), ("tire_grip", 0.8)))
    wrong_first, right_first = (CaseAnswer("missing_physics", s) for s in (both, both[::-1]))
    changed = KnownChange("tape", effects=["tire_grip"])
    said = [KnownResult("", changed, [], a).right for a in (wrong_first, right_first)]
    assert said == [False, True]


@pytest.mark.slow
def test_the_shipped_config_names_recordings_that_are_there(dart_folder, repository, monkeypatch):
    from buggy_rl.proof.real.dataset import load_dataset

    monkeypatch.chdir(repository)
    config = from_command_line(
        "",
        "buggy_rl.proof.real.real:RealProofConfig",
        ["configs/proof_real.yaml", f"known.data.recordings=[{dart_folder}]"],
    )
    assert config.known.data is not None
    dataset = load_dataset("known", config.known.data)
    used = {name for change in config.known.changes.values() for name in change.after}
    assert chosen_recordings(dataset, config.known.fit)
    assert not used & {*config.known.fit}
    for change in config.known.changes.values():
        assert chosen_recordings(dataset, change.baseline)
        assert chosen_recordings(dataset, change.after)
        assert not {*change.baseline} & {*config.known.fit}
