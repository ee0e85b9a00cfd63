"""The diagnosis beside other methods: counted by hand."""

import pytest

from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.ledger import Entry
from buggy_rl.proof.score.outcome import CaseAnswer, ScoredEffect
from buggy_rl.proof.score.rivals import McNemar, comparisons, scores_of

LAG = {"steering_lag": {"time_constant": 0.1}}
TWO = {**LAG, "payload": {"mass_ratio": 1.3}}
RIGHT = CaseAnswer("missing_physics", (ScoredEffect("steering_lag", 0.9),))
BOTH = CaseAnswer("missing_physics", (*RIGHT.said, ScoredEffect("payload", 0.9)))
WRONG = CaseAnswer("missing_physics", (ScoredEffect("wind", 0.9),))
NOTHING = CaseAnswer("no_mismatch")
CRASHED = CaseAnswer(status="crashed")
METHOD = "fit each, by BIC"


def entries(*rows) -> list[Entry]:
    """Lines with what is concealed, what the diagnosis said, and what the method did."""
    return [
        Entry(
            str(seed),
            opened=Case(seed, "reference", "reference", concealed=concealed),
            answers={"ours": ours, METHOD: theirs},
        )
        for seed, (concealed, ours, theirs) in enumerate(rows)
    ]


def test_mcnemars_test_is_the_exact_binomial_of_cases_in_which_one_is_right():
    # Of 6 coins all show one side, or the other: 2 / 2^6.
    assert McNemar(6, 0).p == pytest.approx(2 / 64)
    # Of 8, at most one shows either side: 2 (1 + 8) / 2^8.
    assert McNemar(1, 7).p == pytest.approx(18 / 256)
    assert McNemar(3, 3).p == 1.0
    assert McNemar(0, 0).p == 1.0


def test_wins_losses_and_crashes_are_counted_on_all_cases_and_on_those_it_can_represent():
    every, able = comparisons(
        entries(
            (LAG, RIGHT, WRONG),  # a win
            (LAG, RIGHT, NOTHING),  # a win
            (LAG, WRONG, RIGHT),  # a loss
            (LAG, CRASHED, RIGHT),  # a loss
            (LAG, RIGHT, RIGHT),
            ({}, NOTHING, WRONG),  # a win
            (TWO, BOTH, RIGHT),  # a win that it could not have had: it names one
            (LAG, RIGHT, CRASHED),  # apart
        )
    )
    assert (every.method, every.which) == (METHOD, "all cases")
    assert (every.cases, every.ours, every.theirs, every.crashed) == (7, 5, 3, 1)
    assert (every.test.wins, every.test.losses) == (4, 2)
    assert every.test.p == pytest.approx(2 * (1 + 6 + 15) / 64)
    assert (able.cases, able.ours, able.theirs, able.crashed) == (6, 4, 3, 1)
    assert (able.test.wins, able.test.losses) == (3, 2)
    assert "right alone 2, the diagnosis 3" in str(able)


def test_a_method_that_was_not_asked_is_not_compared():
    [alone] = entries((LAG, RIGHT, RIGHT))
    alone.answers.pop(METHOD)  # type: ignore[attr-defined]
    assert comparisons([alone]) == []
    assert list(scores_of([alone])) == ["ours"]


def test_by_names_given_equations_and_improbable_names_beside_a_right_one_are_not_counted():
    beside = CaseAnswer("missing_physics", (*RIGHT.said, ScoredEffect("term.forward.x.even", 0.5)))
    unsure = CaseAnswer("cannot_tell", (ScoredEffect("steering_lag", 0.4),))
    denied = CaseAnswer("unknown_physics", RIGHT.said)
    offered = CaseAnswer("missing_physics", (ScoredEffect("term.forward.x.even", 0.5),))
    every, able = comparisons(
        entries(
            (LAG, beside, RIGHT),  # a loss, but right by what is given
            (LAG, RIGHT, RIGHT),
            (LAG, unsure, RIGHT),  # right, though not given
            (LAG, denied, RIGHT),  # a loss
            (LAG, CRASHED, RIGHT),  # a loss
            ({}, offered, NOTHING),  # a loss, but nothing is given
        )
    )
    assert (every.ours, every.test.wins, every.test.losses) == (2, 0, 4)
    assert (every.given, every.given_test.wins, every.given_test.losses) == (3, 0, 3)
    assert [o.case.seed for o in able.lost] == [0, 3, 4, 5]
    assert "by names above one half 3, 3 to 0" in str(every)
