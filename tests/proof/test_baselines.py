"""Other methods answer the same questions, and are counted by the same score."""

import json
from collections import Counter

import pytest

from buggy_rl.core.config import load_named
from buggy_rl.core.files import write_json
from buggy_rl.effects import EFFECTS
from buggy_rl.proof import baselines
from buggy_rl.proof.baselines import Method, compare, unanswered_methods
from buggy_rl.proof.baselines.asked import guess
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.sealing import CaseStore
from buggy_rl.proof.running import answers

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


BROKEN = Method("tests.proof.test_baselines:broken", "library")


def test_every_method_answers_once_and_a_failure_is_an_answer(store, monkeypatch):
    monkeypatch.setattr(baselines, "METHODS", {"random guess": baselines.METHODS["random guess"]})
    monkeypatch.setitem(baselines.METHODS, "broken", BROKEN)
    assert unanswered_methods(store, CASE) == list(baselines.METHODS)
    assert compare(store, CASE) == 1
    assert unanswered_methods(store, CASE) == []
    said = json.loads((store.diagnosis(CASE.id) / "baselines.json").read_text())
    assert set(said) == set(baselines.METHODS)
    assert said["broken"]["verdict"] == "crashed"
    assert said["broken"]["notes"] == ["no root found"]
    assert all(answer["seconds"] > 0 for answer in said.values())
    monkeypatch.setitem(baselines.METHODS, "later", BROKEN)
    assert unanswered_methods(store, CASE) == ["later"]


def test_all_methods_can_be_called():
    assert len(baselines.METHODS) == 9
    for method in baselines.METHODS.values():
        assert callable(load_named(method.answer))


def test_a_crash_is_none_of_the_answers(store, monkeypatch):
    monkeypatch.setattr(baselines, "METHODS", {"broken": BROKEN})
    write_json(store.diagnosis(CASE.id) / "outcome.json", {"status": "failed", "seconds": 1.0})
    compare(store, CASE)
    found = answers(store, CASE.id)
    assert {name: answer.status for name, answer in found.items()} == {
        "ours": "crashed",
        "broken": "crashed",
    }


LAG = {"steering_lag": {"time_constant": 0.1}}
GRIP = {"tire_grip": {"grip": 0.7}}
TWO = {**LAG, **GRIP}
OUTSIDE = {"sticky_servo": {"breakaway": 0.2}}


@pytest.mark.parametrize(
    ("method", "simulator", "concealed", "able"),
    [
        ("fit each, by BIC", "mujoco", {}, True),
        ("fit each, by BIC", "mujoco", GRIP, True),
        ("fit each, by BIC", "mujoco", TWO, False),
        ("fit each, by BIC", "mujoco", OUTSIDE, False),
        ("greedy selection", "mujoco", TWO, True),
        ("re-tuning alone", "mujoco", LAG, True),
        ("re-tuning alone", "mujoco", GRIP, False),
        ("re-tuning alone", "single_track_fitted", LAG, True),
        ("re-tuning alone", "learned", LAG, False),
        ("mujoco.sysid", "mujoco_fitted", LAG, True),
        ("mujoco.sysid", "mujoco", GRIP, True),
        ("mujoco.sysid", "mujoco", {"wind": {"force_x": 0.2, "force_y": 0.1}}, False),
        ("mujoco.sysid", "single_track_fitted", LAG, False),
        ("mujoco.sysid", "mujoco", {}, True),
        ("mujoco.sysid", "reference", {}, False),  # it has no answer, not even nothing
        ("black-box residual", "mujoco", {}, True),
        ("black-box residual", "mujoco", LAG, False),
        ("black-box residual", "mujoco", OUTSIDE, True),
    ],
)
def test_what_a_method_can_represent(method, simulator, concealed, able):
    case = Case(1, "mujoco", simulator, True, concealed)
    assert baselines.METHODS[method].represents(case) is able


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
