"""Counting, on outcomes made by hand."""

import pytest

from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.ledger import Entry
from buggy_rl.proof.score.outcome import CaseAnswer, ScoredCase, ScoredEffect
from buggy_rl.proof.score.score import score

LATE = {"steering_dead_time": {"dead_time": 0.05}}


def number(value, low, high):
    return {"value": value, "low": low, "high": high}


def said(name, confidence=0.9, **parameters):
    return ScoredEffect(name, confidence, parameters)


def case(seed=1, concealed=None, **options):
    return Case(seed, "reference", "reference", concealed=concealed or {}, **options)


def answered(
    concealed, *names, verdict="missing_physics", seconds=0.0, margin=50.0, nats=None, **other
):
    if not names and verdict == "missing_physics":
        verdict = "no_mismatch"
    answer = CaseAnswer(verdict, names, seconds=seconds)
    return ScoredCase(case(concealed=concealed), answer, nats, margin, **other)


def rows(*outcomes):
    return {row.name.strip(): row for row in score(outcomes).rows}


def test_a_wrong_name_counts_as_wrong():
    table = rows(
        answered(LATE, said("steering_dead_time")),
        answered(LATE, said("steering_lag")),
        answered(LATE, said("viscous_drag")),
        answered(LATE, said("viscous_drag"), said("steering_dead_time")),
    )
    first = table["first name right, decidable single effects"]
    assert (first.figure.value, first.figure.count, first.met) == (0.25, 4, False)
    # A lag is of the dead time's group, drag is not.
    assert table["right group, decidable single effects"].figure.value == 0.5


def test_a_name_under_the_verdict_unknown_is_not_an_answer():
    o = answered(LATE, said("steering_dead_time", 0.2), verdict="unknown_physics")
    assert not o.right
    assert o.answer.first is None


def test_a_parameter_of_the_simulators_own_that_is_the_effect_is_right():
    assert answered(LATE, said("parameter:steering_dead_time")).right
    assert not answered(LATE, said("parameter:drive_force")).right
    assert answered(LATE, said("parameter:steering_lag")).group_right


def test_cases_that_cannot_be_decided_do_not_count_as_decidable():
    table = rows(
        answered(LATE, said("steering_lag"), margin=3.0),
        answered(LATE, said("steering_lag", 0.4), verdict="cannot_tell", margin=9.9),
        answered(LATE, said("steering_dead_time"), margin=10.0),
    )
    assert table["first name right, decidable single effects"].figure.count == 1
    undecided = table["undecidable, answered so"]
    assert (undecided.figure.value, undecided.figure.count) == (0.5, 2)


def test_what_was_not_weighed_counts_as_decidable():
    table = rows(answered(LATE, said("steering_lag"), margin=None))
    assert table["first name right, decidable single effects"].figure.count == 1


def test_a_time_that_nobody_took_is_no_time():
    table = rows(answered(LATE, seconds=0.0), answered(LATE, seconds=4.0))
    taken = table["seconds a case, median"].figure
    assert (taken.value, taken.count) == (4.0, 1)


def test_what_is_said_where_nothing_is_counts_surely_and_however_improbable():
    sure = answered({}, said("wind", 0.9))
    wrong = answered({}, said("wind", 0.1), verdict="cannot_tell")
    right = answered({})
    table = rows(sure, wrong, right, right)
    above = table["something named where nothing is, above 0.5"]
    assert (above.figure.value, above.met) == (0.25, False)
    assert table["something named where nothing is, however improbable"].met is False
    assert table["something named where nothing is, however improbable"].figure.value == 0.5
    assert [o.right for o in (wrong, right)] == [False, True]


def test_an_unknown_effect_named_with_confidence_counts_against_us():
    sticky = {"sticky_servo": {"breakaway": 0.2}}
    table = rows(
        answered(sticky, said("steering_backlash", 0.9)),
        answered(sticky, said("steering_backlash", 0.4), verdict="unknown_physics"),
        answered(sticky, said("steering_backlash", 0.9), verdict="unknown_physics"),
        answered(sticky, verdict="unknown_physics"),
    )
    assert table["named with confidence above 0.5, outside the library"].figure.value == 0.5
    assert table["called unknown, outside the library"].figure.value == 0.75


def test_of_two_effects_both_must_be_named_and_no_other():
    two = {**LATE, "gyro_bias": {"bias": 0.1}}
    both = (said("gyro_bias"), said("steering_dead_time"))
    table = rows(
        answered(two, *both),
        answered(two, said("gyro_bias")),
        answered(two, *both, said("wind")),
        answered(two, said("gyro_bias"), said("steering_lag"), margin=4.0),
    )
    assert table["exact set, two effects"].figure.value == 0.25
    assert table["of them, both decidable"].figure.value == pytest.approx(1 / 3)


def test_numbers_are_held_against_the_truth_the_oracle_and_their_own_interval():
    oracle = {"steering_dead_time": {"dead_time": 0.06}}
    table = rows(
        # 4 % above the truth, 13 % under the oracle's fit; the interval holds the truth.
        answered(
            LATE,
            said("steering_dead_time", dead_time=number(0.052, 0.049, 0.055)),
            oracle=oracle,
        ),
        # 20 % above the truth, the oracle's own number; the interval does not hold the truth.
        answered(
            LATE,
            said("steering_dead_time", dead_time=number(0.06, 0.055, 0.065)),
            oracle=oracle,
        ),
    )
    assert table["number within 10 % of the truth, where rightly named"].figure.value == 0.5
    assert table["median relative error"].figure.value == pytest.approx(0.12)  # of 0.04, 0.2
    assert table["number within 10 % of the oracle's"].figure.value == 0.5
    assert table["truth inside the 95 % interval"].figure.value == 0.5


def test_intervals_that_always_hold_the_truth_are_too_wide():
    wide = number(0.05, 0.0, 1.0)
    outcomes = [answered(LATE, said("steering_dead_time", dead_time=wide))] * 40
    row = rows(*outcomes)["truth inside the 95 % interval"]
    assert (row.figure.value, row.met) == (1.0, False)


def test_the_gap_closed_is_the_oracles_share():
    held_out = {name: {"error": e, "position": e} for name, e in
                {"as_given": 9.0, "named": 2.0, "oracle": 1.0}.items()}  # fmt: skip
    o = answered(LATE, said("steering_dead_time"), held_out=held_out)
    assert o.closed() == pytest.approx((9 - 2) / (9 - 1))
    shut = {**held_out, "as_given": {"error": 1.01, "position": 1.01}}
    assert answered(LATE, held_out=shut).closed() is None
    assert rows(o)["median gap closed, of the oracle's"].figure.value == pytest.approx(0.875)


def test_confidence_is_counted_where_it_is_claimed():
    result = score([
        answered(LATE, said("steering_dead_time", 0.95)),
        answered(LATE, said("wind", 0.95)),
        answered({}, said("wind", 0.35)),
        answered({}),
    ])  # fmt: skip
    assert result.calibration == [(0.35, 0.0, 1), (0.95, 0.5, 2)]
    assert result.coverage == [(2 / 3, 0.5), (1.0, pytest.approx(1 / 3))]


def test_nothing_that_is_called_unknown_fails_and_so_does_a_right_set_that_is_taken_back():
    two = {**LATE, "gyro_bias": {"bias": 0.1}}
    both = (said("gyro_bias"), said("steering_dead_time"))
    alarm = answered({}, verdict="unknown_physics")
    back = answered(two, *both, verdict="unknown_physics")
    assert score([alarm, back, answered(two, *both)]).failing == [alarm, back]


def test_a_crash_is_wrong_and_listed():
    crash = ScoredCase(case(concealed=LATE), CaseAnswer(status="crashed"), margin=50.0)
    silent = ScoredCase(case(), CaseAnswer(status="timed out"))
    result = score([crash, silent, answered(LATE, said("steering_dead_time"))])
    assert [o.answer.status for o in result.failing] == ["crashed", "timed out"]
    assert result.confusion["steering_dead_time"] == {"crashed": 1, "steering_dead_time": 1}
    table = {row.name.strip(): row for row in result.rows}
    assert table["first name right, decidable single effects"].figure.value == 0.5


def test_classes_are_counted_apart():
    long = ScoredCase(
        case(concealed=LATE, seconds=90.0, nuisance="jitter"),
        CaseAnswer("missing_physics", (said("steering_dead_time"),)),
        nats=250.0,
    )
    short = answered(LATE, said("wind"), nats=20.0)
    breakdown = score([long, short]).breakdown
    assert {k: v.value for k, v in breakdown["drive length"].items()} == {"45 s": 0.0, "90 s": 1.0}
    assert {k: v.value for k, v in breakdown["nuisance"].items()} == {"white": 0.0, "jitter": 1.0}
    assert {k: v.value for k, v in breakdown["size"].items()} == {
        "1: 10 to 30 nats": 0.0,
        "3: 100 to 300 nats": 1.0,
    }


def test_an_outcome_is_read_as_contract_3_writes_it():
    answer = {
        "verdict": "missing_physics",
        "effects": [
            {
                "name": "steering_dead_time",
                "confidence": 0.97,
                "parameters": {
                    "dead_time": {"value": 0.05, "low": 0.04, "high": 0.06, "unit": "s"}
                },
                "confused_with": [{"name": "steering_lag", "confidence": 0.02}],
            }
        ],
    }
    weighed = {"nats": 80.0, "rivals": {"steering_lag": 12.0, "wind": 79.0}}
    told = CaseAnswer.from_diagnosis(answer, {"status": "answered", "seconds": 3.0})
    late = case(concealed=LATE)
    o = Entry(late.id, opened=late, answers={"ours": told}, weighed=weighed).scored()
    assert o.right
    assert o.margin == 12.0
    assert o.answer.said[0].rivals == ("steering_lag",)
    assert o.answer.said[0].values == {"dead_time": 0.05}
    # Nothing at all is a rival like any other.
    weak = {"nats": 4.0, "rivals": {"wind": 79.0}}
    assert not Entry(late.id, opened=late, answers={"ours": told}, weighed=weak).scored().decidable
