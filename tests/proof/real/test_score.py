"""What counts as named, by class and by strength; and the page that shows it."""

import math

import pytest

from buggy_rl.proof.ledger import Entry, Ledger
from buggy_rl.proof.real.case import RealCase
from buggy_rl.proof.real.dataset import DatasetConfig
from buggy_rl.proof.real.known import KnownChange, KnownResult
from buggy_rl.proof.real.measures import Measured
from buggy_rl.proof.real.page import real_page, real_tables, write_real_page
from buggy_rl.proof.real.real import RealProofConfig
from buggy_rl.proof.real.score import RealOutcome, real_score, strength_class
from buggy_rl.proof.score.outcome import CaseAnswer, ScoredEffect

LATE = {"steering_dead_time": {"dead_time": 0.05}}
GAIN = {"throttle_gain": {"gain": 1.2}}
CURVED = {"throttle_exponent": {"exponent": 1.5}}


def outcome(
    concealed, said, strength=None, verdict="missing_physics", baseline=True, seed=0, changed=None
):
    case = RealCase(3_000_000 + seed, "dart", "0a", "single_track", baseline, concealed)
    effects = tuple(ScoredEffect(name, p) for name, p in said.items())
    weighed = {} if strength is None else {"strength": strength, "nats": 1.0, "rivals": {}}
    weighed |= {"changed": changed or {}}
    entry = Entry(
        case.id, "real", case, answers={"ours": CaseAnswer(verdict, effects)}, weighed=weighed
    )
    return RealOutcome.of(entry)


OUTCOMES = [
    outcome(LATE, {"steering_dead_time": 0.9}, {"steering_dead_time": 40.0},
            changed={"steering_dead_time": 9.0}),
    outcome(LATE, {"steering_dead_time": 0.4}, {"steering_dead_time": 3.0}, "cannot_tell"),
    outcome(GAIN, {"payload": 0.8}, {"throttle_gain": 20.0}, seed=7,
            changed={"throttle_gain": 1.0}),
    outcome({**LATE, **GAIN}, {"steering_dead_time": 0.9, "throttle_gain": 0.6},
            {"steering_dead_time": 300.0, "throttle_gain": 8.0}),
    outcome(CURVED, {}, verdict="unknown_physics"),
    outcome({}, {}, verdict="no_mismatch"),
    outcome({}, {"tire_grip": 0.7}, baseline=False),
]  # fmt: skip


@pytest.fixture(scope="module")
def rows():
    return {row.name.strip(): row.figure for row in real_score(OUTCOMES).rows}


@pytest.mark.parametrize(
    ("name", "value", "count"),
    [
        ("one edit: first name right and above one half", 1 / 3, 3),
        ("one edit above 6 nats: first name right and above one half", 1 / 2, 2),
        ("above 6 nats of second evidence", 1, 1),
        ("first name right, however sure", 2 / 3, 3),
        ("one edit: a wrong name above one half", 1 / 3, 3),
        ("two edits: both named above one half", 1, 1),
        ("unknown edit: a name above one half", 0, 1),
        ("unknown edit: called unknown", 1, 1),
        ("nothing edited, with a baseline: something named above one half", 0, 1),
        ("nothing edited, without one: something named above one half", 1, 1),
        ("crashed or timed out", 0, 7),
    ],
)
def test_figures_are_counts(rows, name, value, count):
    assert (rows[name].value, rows[name].count) == (pytest.approx(value), count)


def test_recall_and_precision_by_strength():
    found = {row.least: row for row in real_score(OUTCOMES).strengths}
    # Effects: 40, 3, 20 (not named), 300, 8 nats; named are 40, 300 and 8.
    assert (found[-math.inf].recall.value, found[-math.inf].recall.count) == (3 / 5, 5)
    assert (found[6.0].recall.value, found[6.0].recall.count) == (3 / 4, 4)
    # Cases all of whose effects have 6 nats: names 1 right, payload wrong, 2 right.
    assert (found[6.0].precision.value, found[6.0].precision.count) == (3 / 4, 4)
    assert found[1000.0].recall.count == 0


def test_effects_that_can_be_found_are_listed_beside_what_is_said_of_them():
    score = real_score(OUTCOMES)
    assert [(e.effect, e.nats, e.named, e.first) for e in score.visible] == [
        ("steering_dead_time", 40.0, True, True),
        ("throttle_gain", 20.0, False, False),
        ("steering_dead_time", 300.0, True, True),
        ("throttle_gain", 8.0, True, False),
    ]
    assert (score.cases, score.effects, score.names) == (7, 5, 5)
    hidden = outcome(LATE, {"steering_dead_time": 0.3}, {"steering_dead_time": 9.0}, "cannot_tell")
    [effect] = real_score([hidden]).visible
    assert (effect.named, effect.first) == (False, True)


def test_tables_for_other_pages():
    tables = real_tables(real_score(OUTCOMES), ["commit abc"])
    assert tables["targets"].count("\n") == 1 + 4
    assert tables["counted"] == "7 cases; commit abc."
    assert (
        "| one edit above 6 nats: first name right and above one half | at least 85 % | **50.0 % ("
        in tables["answers"]
    )
    assert tables["named"] == (
        "Effects concealed: 5; above 6 nats: 4, of which 3 named above one half, 0 first with "
        "less, 1 neither. Names above one half: 5, of which 2 wrong. Edits that no effect "
        "describes: 1, of which 0 with a name above one half."
    )


def test_classes_of_single_edits():
    by = real_score(OUTCOMES).classes
    assert {label: [f.value for f in both] for label, both in by["edit"].items()} == {
        "steering_dead_time": [0.5, 0.0],
        "throttle_gain": [0.0, 1.0],
    }
    assert list(by["strength"]) == ["1: 0 to 6 nats", "3: 12 to 30 nats", "4: 30 to 100 nats"]
    assert strength_class(-1.0) == "0: below 0 nats"
    assert strength_class(2000.0) == "7: above 1000 nats"
    assert strength_class(None) == "not weighed"


def config(tmp_path) -> RealProofConfig:
    return RealProofConfig(output=str(tmp_path / "out"), datasets={"dart": DatasetConfig()})


MEASURED = Measured("speed at a throttle", "m/s", 2.0, 2.4, 1.2, 1.1, 1.3)
GAINED = KnownChange("a full battery", effects=["throttle_gain"])


def said(name, confidence, verdict):
    return CaseAnswer(verdict, (ScoredEffect(name, confidence),))


KNOWN = [
    KnownResult("full_battery", GAINED, [MEASURED], said("throttle_gain", 0.8, "missing_physics")),
    KnownResult("repeat", KnownChange(), [], said("wind", 0.6, "cannot_tell")),
    KnownResult("later", KnownChange(), [], None),
]


def test_the_page_lists_every_wrong_name_and_every_known_change(tmp_path):
    text = real_page(config(tmp_path), real_score(OUTCOMES), KNOWN, "prove", 1)
    assert (
        "| 3000007 | dart 0a | single_track | given | throttle_gain gain 1.2 | 20 | "
        "missing physics: payload (0.80) |"
    ) in text
    assert (
        "| 3000007 | dart 0a | single_track | given | throttle_gain gain 1.2 | 20 |  | "
        "missing physics: payload (0.80) |"
    ) in text
    assert (
        "| full battery | a full battery | speed at a throttle | 2 m/s | 2.4 m/s | 1.20 (" in text
    )
    assert "| missing physics: throttle_gain (0.80) | right |" in text
    assert "| cannot tell: wind (0.60) | **not right** |" in text
    assert "|  | not diagnosed |" in text
    assert "Forces, tyres, bodies, lags and rate limits are not covered" in text
    assert "they were scored 1 time. Intervals" in text


def test_the_page_is_written_beside_the_cases(tmp_path):
    file = write_real_page(config(tmp_path), real_score([]), [], "prove", 0)
    assert file == tmp_path / "out" / "proof_real.md"
    assert "no case" in file.read_text()


def test_a_line_of_the_ledger_keeps_case_and_source(tmp_path):
    case = RealCase(3_000_000, "dart", "0a", "learned", True, LATE)
    made = {"commit": "abc", "source": "0" * 64, "time": "2026-01-01T00:00:00+00:00"}
    entry = Entry(case.id, "real", case, answers={"ours": CaseAnswer()}, made=made)
    ledger = Ledger(tmp_path / "ledger.jsonl")
    ledger.enter([entry])
    assert ledger.entries() == [entry]


def test_what_a_case_cannot_be_is_refused():
    with pytest.raises(ValueError, match=r"no edits \['wind'\]; available: battery_sag"):
        RealCase(1, "dart", "0a", "mujoco", concealed={"wind": {}})
    with pytest.raises(ValueError, match="no engine 'hold'"):
        RealCase(1, "dart", "0a", "hold")
    with pytest.raises(ValueError, match="datasets is empty"):
        RealProofConfig(output="out")
    with pytest.raises(ValueError, match=r"no stages \['compare'\]"):
        RealProofConfig(output="out", stages=["compare"])
