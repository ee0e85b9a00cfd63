"""The page: every figure with its target, every failing case with the truth."""

from collections import Counter
from dataclasses import replace

import pytest

from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.page import page_tables, proof_page, reason, write_page
from buggy_rl.proof.proof import ProofConfig
from buggy_rl.proof.score.answers import WeighedAnswer
from buggy_rl.proof.score.outcome import CaseAnswer, ScoredCase, ScoredEffect
from buggy_rl.proof.score.rivals import ABLE, ALL, McNemar, MethodComparison
from buggy_rl.proof.score.score import passed, score

LATE = {"steering_dead_time": {"dead_time": 0.05}}
TWO = {**LATE, "wind": {"force_x": 0.2, "force_y": -0.3}}
OUTSIDE = {"sticky_servo": {"band": 0.1}}
late, lag, drag = (
    ScoredEffect(name, 0.9, rivals=rivals)
    for name, rivals in (
        ("steering_dead_time", ()),
        ("steering_lag", ("steering_dead_time",)),
        ("viscous_drag", ()),
    )
)
WIND = {"wind": {"force_x": 0.2, "force_y": -0.3}}
NUMBERS = {"rate": {"value": 0.123, "low": 0.1, "high": 0.2}}


@pytest.fixture(scope="module")
def scores():
    right = ScoredCase(
        Case(1, "reference", "reference", concealed=WIND),
        CaseAnswer("missing_physics", (ScoredEffect("wind", 0.9),)),
        margin=40.0,
    )
    wrong = ScoredCase(
        Case(2, "reference", "reference", concealed=WIND, nuisance="jitter"),
        CaseAnswer("missing_physics", (ScoredEffect("viscous_drag", 0.8, NUMBERS),)),
        margin=12.0,
    )
    none = ScoredCase(Case(3, "reference", "reference"), CaseAnswer("no_mismatch"))
    return {"ours": score([right, wrong, none]), "guessing": score([wrong, none])}


def test_the_table_has_targets_figures_and_who_else_answered(scores):
    lines = proof_page(ProofConfig(output="out"), scores, [], "prove", 0, {}).splitlines()
    assert "| figure | target | measured | n | guessing |" in lines
    first = next(line for line in lines if line.startswith("| first name right, decidable"))
    # 1 of 2: Wilson's interval of a half is 9.5 to 90.5 %; what misses its target stands out.
    assert "| at least 90 % | **50.0 % (9.5 to 90.5)** | 2 | 0.0 % (0.0 to 79.3) |" in first


def test_other_methods_stand_beside_with_their_test(scores):
    row = MethodComparison("guessing", "all cases", 9, 7, 1, 2, McNemar(6, 0), 8, McNemar(7, 0))
    text = proof_page(ProofConfig(output="out"), scores, [row], "prove", 0, {})
    assert "| guessing | all cases | 9 | 1 | 7 | 6 : 0 | 0.031 | 8 | 7 : 0 | 0.016 | 2 |" in text
    assert "## Beside other methods" not in proof_page(
        ProofConfig(output="out"), scores, [], "prove", 0, {}
    )


def test_failing_cases_tell_what_was_said_and_what_was_true(scores):
    text = proof_page(ProofConfig(output="out"), scores, [], "prove", 0, {}).partition(
        "## Cases that fail"
    )[2]
    assert text.splitlines()[4:] == [
        "| 0000002 | reference -> reference | jitter | 2 x 45 s rich | "
        "wind force_x 0.2, force_y -0.3 | missing physics: viscous_drag rate 0.123 (0.80) "
        "| 12 nats | wind is not named; viscous_drag is not there |"
    ]
    none = ScoredCase(Case(3, "reference", "reference"), CaseAnswer("no_mismatch"))
    good = {"ours": score([none])}
    text = proof_page(ProofConfig(output="out"), good, [], "prove", 0, {})
    assert text.endswith("## Cases that fail\n\nNone.\n")


def test_the_page_says_how_it_is_made_and_shows_its_pictures(scores, tmp_path):
    config = ProofConfig(output=str(tmp_path / "out"), page=str(tmp_path / "docs" / "proof.md"),
                         images=str(tmp_path / "docs" / "images"))  # fmt: skip
    file = write_page(config, scores, [], "python scripts/prove.py configs/proof.yaml", 0)
    text = file.read_text()
    assert "```sh\npython scripts/prove.py configs/proof.yaml\n```" in text
    assert "development seeds" in text
    for kind in ("figures", "classes", "confidence", "confusion"):
        assert f"](images/proof_{kind}.png)" in text
        picture = tmp_path / "docs" / "images" / f"proof_{kind}.png"
        assert picture.read_bytes().startswith(b"\x89PNG")


def test_what_was_said_of_each_effect_adds_up(scores):
    assert scores["ours"].confusion == {
        "nothing": Counter({"no_mismatch": 1}),
        "wind": Counter({"wind": 1, "viscous_drag": 1}),
    }


def test_composed_physics_and_terms_are_one_kind_of_what_is_confused():
    composed = {"forward.steering.linear.heat": {"size": -1.0, "time_constant": 5.0}}
    term = ScoredEffect("term.forward.steering.even", 0.5)
    outcomes = [answered(composed, term), answered(composed, verdict="unknown_physics")]
    confused = score(outcomes).confusion
    assert confused == {"an equation": Counter({"an equation": 1, "unknown_physics": 1})}


def answered(concealed, *said, verdict="missing_physics", status="answered", margin=None):
    case = Case(1, "reference", "reference", concealed=concealed)
    return ScoredCase(case, CaseAnswer(verdict, said, status), margin=margin)


@pytest.mark.parametrize(
    ("outcome", "why"),
    [
        (answered(LATE, status="timed out"), "no answer"),
        (answered({}, drag), "a name for nothing"),
        (answered({}, verdict="unknown_physics"), "nothing is there, and it is not known what"),
        (answered(OUTSIDE, verdict="no_mismatch"), "not seen"),
        (answered(OUTSIDE, drag), "taken for what the library has"),
        (answered(OUTSIDE, ScoredEffect("wind", 0.4)), "named, though not surely"),
        (answered(LATE, verdict="no_mismatch"), "not seen"),
        (answered(LATE, verdict="unknown_physics"), "no name earned its place"),
        (answered(LATE, late, verdict="unknown_physics"), "called unknown"),
        (answered(LATE, lag), "steering_dead_time stands as a rival; steering_lag is not there"),
        (answered(LATE, drag, late), "viscous_drag is not there"),
        (
            answered(LATE, drag, margin=3.0),
            "another cause does as well on these drives; steering_dead_time is not named; "
            "viscous_drag is not there",
        ),
        (
            answered(TWO, late, margin=3.0),
            "one of them hardly shows in these drives; wind is not named",
        ),
    ],
)
def test_why_an_answer_failed(outcome, why):
    assert not passed(outcome)
    assert reason(outcome) == why


def test_answers_stand_first_with_a_curve_over_strength(tmp_path):
    right = ScoredCase(
        Case(1, "reference", "reference", concealed=WIND),
        CaseAnswer("missing_physics", (ScoredEffect("wind", 0.9),)),
    )
    missed = replace(right, answer=CaseAnswer("unknown_physics"))
    answers = [
        WeighedAnswer(scored, {"wind": nats}) for scored, nats in ((right, 50.0), (missed, 3.0))
    ]
    config = ProofConfig(output=str(tmp_path / "out"), page=str(tmp_path / "proof.md"))
    scored = {"ours": score([right, missed])}
    text = write_page(config, scored, [], "prove", 0, answers).read_text()
    assert text.index("## Answers") < text.index("## The figures")
    assert "| effects above 6 nats that are named, of one | at least 90 % | 100.0 %" in text
    by_strength = text.partition("| strength of at least [nats] |")[2].splitlines()[2:]
    assert by_strength[0].startswith("| any | 50.0 %")
    assert by_strength[2].startswith("| 6 | 100.0 %")
    assert (tmp_path / "proof_strength.png").exists()


def test_every_wrong_name_above_one_half_has_a_row():
    said = (ScoredEffect("viscous_drag", 0.8, NUMBERS), ScoredEffect("wind", 0.6))
    wrong = ScoredCase(
        Case(7, "reference", "reference", concealed=WIND), CaseAnswer("missing_physics", said)
    )
    unsure = replace(wrong, answer=CaseAnswer("missing_physics", (ScoredEffect("payload", 0.4),)))
    scored, config = {"ours": score([wrong, unsure])}, ProofConfig(output="out")
    answers = [WeighedAnswer(wrong, {"wind": 50.0}), WeighedAnswer(unsure)]
    text = proof_page(config, scored, [], "prove", 0, {}, answers)
    rows = text.partition("Every wrong name above one half:")[2].partition("## ")[0].splitlines()
    [row] = [row for row in rows if row.startswith("| 0000007")]
    assert row.endswith("| wind 50 | viscous_drag rate 0.123 (0.80) | wind (0.60) |")
    assert "None." in proof_page(config, scored, [], "prove", 0, {}, answers[1:])
    counted = page_tables(answers, [])["misnamed"]
    assert counted.startswith(f"Of {len(answers)} cases, 1 have a wrong name above one half: 1 in")


def test_every_case_that_another_method_alone_has_is_told_with_who_has_it():
    case = Case(7, "reference", "reference", concealed=WIND)
    said = (ScoredEffect("wind", 0.9), ScoredEffect("term.forward.x.even", 0.5))
    lost = (ScoredCase(case, CaseAnswer("missing_physics", said)),)
    test = McNemar(0, 1)
    compared = [
        MethodComparison(name, which, 1, 0, 1, 0, test, 1, McNemar(0, 0), lost)
        for name in ("guessing", "fitting", "regression")
        for which in (ALL, ABLE)
        if (name, which) != ("regression", ABLE)
    ]
    assert page_tables([], compared)["lost"].splitlines()[2:] == [
        "| 0000007 | reference -> reference | wind | missing physics: wind  (0.90); "
        "term.forward.x.even  (0.50) | right | guessing; fitting |"
    ]
    told = page_tables([], compared)["beside"]
    assert told.endswith("the names above one half are right: guessing 1 (1), fitting 1 (1).")
    assert page_tables([], compared[4:])["lost"] == "None."
    assert page_tables([], compared[4:])["beside"].endswith(": none.")


def test_other_pages_have_a_row_for_each_method():
    whole = MethodComparison("guessing", ALL, 9, 7, 1, 2, McNemar(6, 0), 8, McNemar(7, 0))
    able = MethodComparison("guessing", ABLE, 4, 3, 1, 0, McNemar(2, 1), 3, McNemar(3, 1))
    assert page_tables([], [whole, able])["methods"].splitlines()[2:] == [
        "| guessing (4) | 6 : 0 | 0.031 | 2 : 1 | 1 | 3 : 1 | 0.62 |"
    ]
