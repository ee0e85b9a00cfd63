"""Scored cases: entered once, when nothing is left to do, and the same wherever they are read."""

import json
from dataclasses import asdict

import pytest

from buggy_rl.core.files import write_json
from buggy_rl.proof.baselines import METHODS
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.sealing import CaseStore, publish, seal
from buggy_rl.proof.score.outcome import OURS, Ledger, complete, open_once, openings, read_outcomes

CASE = Case(31, "reference", "reference", concealed={"payload": {"mass_ratio": 1.3}}, seconds=1.3)
OTHER = Case(32, "reference", "reference", seconds=1.3)
ANSWER = {
    "verdict": "missing_physics",
    "effects": [
        {
            "name": "payload",
            "confidence": 0.9,
            "parameters": {
                "mass_ratio": {"value": 1.28, "low": 1.2, "high": 1.36, "unit": "ratio"}
            },
            "confused_with": [{"name": "throttle_gain", "confidence": 0.1}],
        }
    ],
}
WEIGHED = {
    "nats": 80.0,
    "rivals": {"throttle_gain": 40.0},
    "parameters": {"payload": {"mass_ratio": 1.29}},
    "held_out": {n: {"error": e, "position": e} for n, e in (("as_given", 3.0), ("oracle", 1.0))},
}


def answered(store: CaseStore, case: Case) -> None:
    write_json(store.diagnosis(case.id) / "diagnosis.json", ANSWER)
    write_json(store.diagnosis(case.id) / "outcome.json", {"status": "answered", "seconds": 3.0})


@pytest.fixture
def store(tmp_path) -> CaseStore:
    made = CaseStore(tmp_path / "open", tmp_path / "safe")
    for folder in (made.output, made.sealed):
        folder.mkdir()
    publish(made, [CASE, OTHER])
    seal(made, [CASE], [])
    answered(made, CASE)
    return made


def test_a_case_is_entered_when_nothing_is_left_to_do_and_once(store, tmp_path):
    ledger = Ledger(tmp_path / "ledger.jsonl")
    assert not complete(store, CASE)
    assert ledger.settle(store) == 0
    assert ledger.open([CASE, OTHER]) == [CASE, OTHER]
    write_json(store.oracle(CASE.id), WEIGHED)
    assert ledger.settle(store) == 0  # other methods have not answered
    answered(store, CASE)  # asked anew: what was weighed was another answer
    assert not store.weighed(CASE.id)
    assert ledger.settle(store, compared=False) == 0
    write_json(store.oracle(CASE.id), WEIGHED)
    assert ledger.settle(store, compared=False) == 1
    assert ledger.settle(store, compared=False) == 0
    assert ledger.open([CASE, OTHER]) == [OTHER]


def test_where_other_methods_answer_none_is_settled_before_all_have(store, tmp_path):
    write_json(store.oracle(CASE.id), WEIGHED)
    ledger, file = Ledger(tmp_path / "ledger.jsonl"), store.diagnosis(CASE.id) / "baselines.json"
    silent = {"verdict": "cannot_tell", "effects": [], "seconds": 1.0}
    write_json(file, {next(iter(METHODS)): silent})
    assert ledger.settle(store, compared=False) == 0
    write_json(file, dict.fromkeys(METHODS, silent))
    assert ledger.settle(store, compared=False) == 1
    assert set(ledger.entries()[CASE.id]) == {OURS, *METHODS}


def test_what_is_read_is_what_was_entered_without_the_case_at_hand(store, tmp_path):
    write_json(store.oracle(CASE.id), WEIGHED)
    ledger = Ledger(tmp_path / "ledger.jsonl")
    ledger.settle(store, compared=False)
    elsewhere = CaseStore(tmp_path / "elsewhere", tmp_path / "elsewhere_sealed")
    assert ledger.outcomes(elsewhere, [CASE, OTHER]) == read_outcomes(store)
    assert ledger.outcomes(store, [CASE, OTHER]) == read_outcomes(store)  # not twice
    [own] = ledger.outcomes(elsewhere, [CASE])[OURS]
    assert (own.right, own.margin) == (True, 40.0)
    assert own.said[0].rivals == ("throttle_gain",)
    assert ledger.outcomes(store, [OTHER]) == {OURS: []}


def test_a_ledger_of_other_settings_is_refused(store, tmp_path):
    write_json(store.oracle(CASE.id), WEIGHED)
    ledger = Ledger(tmp_path / "ledger.jsonl")
    ledger.settle(store, compared=False)
    with pytest.raises(
        ValueError, match=r"ledger\.jsonl: case 0000031 was drawn by other settings"
    ):
        ledger.open([Case(31, "reference", "reference", seconds=1.3)])


@pytest.mark.parametrize(
    "line", ["{", "[]", '{"id": "0000031"}', '{"id": 1, "outcomes": {"o": {}}}']
)
def test_a_line_that_is_none_is_named(tmp_path, line):
    file = tmp_path / "ledger.jsonl"
    file.write_text(line + "\n")
    with pytest.raises(ValueError, match=r"ledger\.jsonl, line 1: not a scored case"):
        Ledger(file).entries()


def test_hashes_stand_before_any_drive_and_are_those_of_what_is_sealed_later(store):
    before = store.hashes.read_text()
    seal(store, [OTHER], [])
    assert store.hashes.read_text() == before
    assert store.cases() == [CASE, OTHER]
    publish(store, [OTHER, Case(33, "reference", "reference", seconds=1.3)])
    assert store.hashes.read_text().startswith(before)
    with pytest.raises(ValueError, match="another hash of case 0000033"):
        publish(store, [Case(33, "reference", "reference", seconds=1.4)])


def test_an_answer_that_was_asked_about_and_is_gone_is_missed(store):
    store.truth(CASE.id).unlink()
    with pytest.raises(FileNotFoundError):
        store.cases()


def test_the_hash_can_be_checked_by_hand(store):
    content = json.loads(store.truth(CASE.id).read_text())
    assert content["case"] == asdict(CASE)
    assert set(store.digests()) == {CASE.id, OTHER.id}


def test_openings_are_counted(tmp_path):
    file = tmp_path / "opened.json"
    assert openings(file) == 0
    assert [open_once(file), open_once(file), openings(file)] == [1, 2, 2]
