"""The second run: suggested manoeuvres are driven in the same concealed car."""

import json

import pytest
import torch

from buggy_rl.core import keys
from buggy_rl.diagnosis.answer.experiments import TIMES
from buggy_rl.diagnosis.answer.manoeuvres import MANOEUVRES
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.sealing import (
    CaseStore,
    again,
    drive_again,
    driven_again,
    publish,
    seal,
    suggested_manoeuvres,
)
from buggy_rl.proof.running import asked, open_entry
from buggy_rl.recordings import load_recordings

CASE = Case(21, "reference", "reference", concealed={"steering_gain": {"gain": 0.8}}, seconds=1.3)
MANOEUVRE = min(MANOEUVRES, key=lambda m: m.seconds)


def answer(store, id_, verdict, *effects, suggest=()):
    store.diagnosis(id_).mkdir(parents=True, exist_ok=True)
    content = {
        "verdict": verdict,
        "effects": [{"name": name, "confidence": 0.4} for name in effects],
        "excitation": {"weak": [], "suggest": list(suggest)},
    }
    (store.diagnosis(id_) / "diagnosis.json").write_text(json.dumps(content))
    outcome = {"status": "answered", "seconds": 1.0}
    (store.diagnosis(id_) / "outcome.json").write_text(json.dumps(outcome))


@pytest.fixture(scope="module")
def store(tmp_path_factory) -> CaseStore:
    folder = tmp_path_factory.mktemp("again")
    made = CaseStore(folder / "open", folder / "safe")
    made.output.mkdir()
    made.sealed.mkdir()
    seal(made, [CASE], [])
    publish(made, [CASE])
    return made


def test_only_a_case_that_cannot_be_told_is_driven_again(store):
    words = f"{MANOEUVRE.words} (tells steering_lag from steering_gain, by 9 times the noise)"
    answer(store, CASE.id, "missing_physics", "steering_lag", suggest=[words])
    assert suggested_manoeuvres(store, CASE) == []
    answer(store, CASE.id, "cannot_tell", "steering_lag")
    assert suggested_manoeuvres(store, CASE) == []
    answer(store, CASE.id, "cannot_tell", "steering_lag", suggest=[words])
    assert suggested_manoeuvres(store, CASE) == [MANOEUVRE]
    assert not driven_again(store, CASE)


def test_the_manoeuvre_is_driven_and_added_to_what_was_seen(store):
    assert drive_again(store, CASE) == 1
    assert driven_again(store, CASE)
    seen = store.inputs(again(CASE))
    recordings, refusals = load_recordings([str(seen / "recordings")])
    assert refusals == []
    assert [r.name for r in recordings] == [
        "drive_0",
        "drive_1",
        *(f"manoeuvre_{n}" for n in range(TIMES)),
    ]
    expected = MANOEUVRE.actions(0.01)
    headings = set()
    for recording in recordings[2:]:
        action = recording.data[keys.ACTION]
        torch.testing.assert_close(action, expected, atol=1e-5, rtol=0)
        headings.add(round(float(recording.data[keys.POSE][0, 2]), 1))
    assert len(headings) == TIMES
    same = (store.inputs(CASE.id) / "question.yaml", seen / "question.yaml")
    assert same[0].read_text() == same[1].read_text()


def test_the_second_answer_says_whether_it_was_decided(store):
    def decided():
        [entry] = asked(store, [CASE])
        return open_entry(store, entry).scored().decided

    assert decided() is None
    answer(store, again(CASE), "missing_physics", "steering_gain")
    assert decided() is True
    answer(store, again(CASE), "missing_physics", "steering_lag")
    assert decided() is False
    answer(store, again(CASE), "cannot_tell", "steering_gain")
    assert decided() is False
