"""Other methods answer the same questions, and are counted by the same score."""

import json
from collections import Counter

import pytest

from buggy_rl.core.config import load_named
from buggy_rl.effects import EFFECTS
from buggy_rl.proof import baselines
from buggy_rl.proof.baselines import compare, unanswered_methods
from buggy_rl.proof.baselines.asked import guess
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.sealing import CaseStore

CASE = Case(1, "reference", "reference")


@pytest.fixture
def store(tmp_path) -> CaseStore:
    made = CaseStore(tmp_path / "open", tmp_path / "safe")
    (made.inputs(CASE.id) / "recordings").mkdir(parents=True)
    (made.inputs(CASE.id) / "recordings" / "drive_0.csv").write_text("t,x")
    (made.inputs(CASE.id) / "question.yaml").write_text("simulator: simulator.yaml")
    return made


def broken(seen):
    raise ValueError("no root found")


def test_every_method_answers_once_and_a_failure_is_an_answer(store, monkeypatch):
    monkeypatch.setattr(baselines, "METHODS", {"random guess": baselines.METHODS["random guess"]})
    monkeypatch.setitem(baselines.METHODS, "broken", "tests.proof.test_baselines:broken")
    assert unanswered_methods(store, CASE) == list(baselines.METHODS)
    assert compare(store, CASE) == 1
    assert unanswered_methods(store, CASE) == []
    said = json.loads((store.diagnosis(CASE.id) / "baselines.json").read_text())
    assert set(said) == set(baselines.METHODS)
    assert said["broken"]["verdict"] == "crashed"
    assert said["broken"]["notes"] == ["no root found"]
    assert all(answer["seconds"] > 0 for answer in said.values())
    monkeypatch.setitem(baselines.METHODS, "later", "tests.proof.test_baselines:broken")
    assert unanswered_methods(store, CASE) == ["later"]


def test_all_methods_that_the_issue_asks_for_are_there():
    assert set(baselines.METHODS) == {
        "random guess",
        "re-tuning alone",
        "mujoco.sysid",
        "sparse regression",
        "largest cross-correlation",
        "black-box residual",
    }
    for name in baselines.METHODS.values():
        assert callable(load_named(name))


def test_guesses_are_spread_over_the_library_and_repeat(store):
    drive = store.inputs(CASE.id) / "recordings" / "drive_0.csv"
    names = Counter()
    for number in range(400):
        drive.write_text(f"t,x\n{number}")
        answer = guess(store.inputs(CASE.id))
        assert answer == guess(store.inputs(CASE.id))
        names[answer["effects"][0]["name"] if answer["effects"] else ""] += 1
    # 400 guesses of 34: 11.8 each, standard deviation 3.4.
    assert set(names) == {"", *EFFECTS}
    assert max(names.values()) < 11.8 + 5 * 3.4
