"""Posterior: probabilities that sum to one, and what they say."""

import json
import math
from dataclasses import replace

import pytest

from buggy_rl.diagnosis.search.candidate import Variation, leading
from buggy_rl.diagnosis.search.case_evidence import CaseEvidence
from buggy_rl.diagnosis.search.posterior import (
    Calibration,
    FormError,
    Posterior,
    certainly_missing,
    load_calibration,
    of_case,
    of_hypotheses,
    posterior,
    varying,
)
from buggy_rl.estimation.evidence import BaselineMisfit
from tests.diagnosis.observations import case, hypothesis

NOTHING = hypothesis((), [50.0, 60.0], 1.0)
DRAG = hypothesis(("viscous_drag",), [20.0, 25.0], 0.02)
BOTH = hypothesis(("gyro_bias", "viscous_drag"), [19.5, 25.0], 0.02)
OTHER = hypothesis(("wind",), [22.0, 26.0], 0.05)
BY_LOSS = Calibration({"ratio": 20.0, "effects": 3.0}, {"one": -40.0})


def test_probabilities_are_a_softmax_of_weighted_features_and_sum_to_one():
    found = posterior(case([NOTHING, DRAG, BOTH, OTHER]), BY_LOSS)
    assert sum(found.sets.values()) + found.unknown == pytest.approx(1.0)
    # Losses 45, 44.5 and 48 nats: 20 ln(loss + 4) of each, and 3 more for each effect.
    odds = found.sets["viscous_drag",] / found.sets["gyro_bias", "viscous_drag"]
    assert odds == pytest.approx(math.exp(3.0) * (48.5 / 49) ** 20)
    odds = found.sets["viscous_drag",] / found.sets["wind",]
    assert odds == pytest.approx((52 / 49) ** 20)
    assert found.best == ("viscous_drag",)
    assert found.says == "effects"


def test_an_effect_is_as_probable_as_all_sets_that_have_it():
    found = Posterior({(): 0.1, ("a",): 0.4, ("a", "b"): 0.2, ("c",): 0.2}, 0.1)
    assert found.of("a") == pytest.approx(0.6)
    assert found.of("b") == pytest.approx(0.2)
    assert found.of("d") == 0
    assert found.in_place_of("a") == {"c": 0.2}
    # If effects are missing at all: 0.6 of the 0.8 that all sets of effects have.
    assert found.whatever_else("a") == pytest.approx(0.75)
    assert Posterior({(): 1.0}, 0.0).whatever_else("a") == 0


def test_a_name_stands_whatever_else_is_missing_only_if_it_is_likely_itself():
    assert certainly_missing(0.97, 0.4)
    assert not certainly_missing(0.99, 0.05)  # nearly all sets have it, and no set is likely
    assert not certainly_missing(0.9, 0.45)


@pytest.mark.parametrize(
    ("nothing", "unknown", "says"),
    [(0.5, 0.2, "nothing"), (0.2, 0.5, "unknown"), (0.2, 0.2, "effects"), (0.4, 0.3, "nothing")],
)
def test_what_is_most_probable_is_said(nothing, unknown, says):
    left = 1 - nothing - unknown
    assert Posterior({(): nothing, ("a",): left / 2, ("b",): left / 2}, unknown).says == says


def test_what_was_asked_for_is_no_answer():
    asked = hypothesis(("payload",), [1.0, 1.0], 0.0, asked=True)
    found = posterior(case([NOTHING, DRAG, asked]), BY_LOSS)
    assert ("payload",) not in found.sets


def test_features_speak_for_the_hypothesis_that_predicts_better():
    nothing, drag, both, other = of_hypotheses(case([NOTHING, DRAG, BOTH, OTHER]))
    assert drag["ratio"] == pytest.approx(-math.log(49 / 48.5))
    assert both["ratio"] == 0
    assert drag["left"] > other["left"] > nothing["left"]
    assert drag["typical"] > other["typical"] > nothing["typical"]
    assert drag["blocks"] == 0  # the leading one is no worse than itself
    assert other["blocks"] < 0
    assert nothing["blocks"] < other["blocks"]
    assert (nothing["effects"], drag["effects"], both["effects"]) == (0, -1, -2)
    assert nothing["nothing"] == 1 - drag["nothing"] == 1


def test_a_set_is_worth_what_its_least_needed_effect_gains():
    nothing, drag, both, other = of_hypotheses(case([NOTHING, DRAG, BOTH, OTHER]))
    # Without it: 65 nats; the gyro bias beside it gains 0.5, and the drag has 65 to itself.
    assert drag["weakest"] == pytest.approx(math.log1p(65 / 4))
    assert both["weakest"] == pytest.approx(math.log1p(0.5 / 4))
    assert nothing["weakest"] == nothing["weakest_blocks"] == 0
    assert drag["weakest_blocks"] > other["weakest_blocks"] > both["weakest_blocks"] > 0
    # What fits worse than nothing is not worth having.
    worse = hypothesis(("wind",), [60.0, 65.0], 1.2)
    assert of_hypotheses(case([NOTHING, DRAG, worse]))[2]["weakest"] == pytest.approx(
        -math.log1p(15 / 4)
    )


def test_what_varies_lies_at_a_bound_or_helps_on_the_baseline_speaks_against_it():
    worse = replace(
        DRAG,
        varies={"viscous_drag": Variation("vx", 0.3, 20.0)},
        at_bound=("viscous_drag",),
        on_baseline=0.8,  # 32 of the 65 nats that it gains here
    )
    same, changed = (of_hypotheses(case([NOTHING, h]))[1] for h in (DRAG, worse))
    assert (same["varies"], same["at_bound"], same["on_baseline"]) == (0, 0, 0)
    assert changed["varies"] < -1
    assert changed["at_bound"] == -1
    assert changed["on_baseline"] == pytest.approx(-32 / 65)
    alike = {k for k in same if same[k] == changed[k]}
    assert alike == set(same) - {"varies", "at_bound", "on_baseline"}


def test_a_variation_that_helps_nowhere_counts_as_none():
    worse = replace(DRAG, varies={"viscous_drag": Variation("vx", -0.5, 1.0)})
    same, changed = (of_hypotheses(case([NOTHING, h]))[1] for h in (DRAG, worse))
    assert same["varies"] == changed["varies"] == 0


def test_the_leading_hypothesis_has_an_effect_more_only_if_that_is_worth_its_price():
    assert case([NOTHING, DRAG, BOTH]).leading is DRAG
    better = replace(BOTH, held_out=(10.0, 15.0))
    assert leading([NOTHING, DRAG, better], lambda h: h.loss) is better


def test_excess_is_counted_beyond_what_is_usual():
    assert BaselineMisfit(0.0, 0.0).beyond(0.5) == 0.5
    assert BaselineMisfit(0.6, 0.0).beyond(0.5) == 0
    assert BaselineMisfit(0.5, 0.1).beyond(0.5) == pytest.approx(0.1 / math.sqrt(2 * math.pi))
    assert BaselineMisfit(0.5, 0.1).beyond(2.0) == pytest.approx(1.5)


def test_what_was_seen_is_read_as_it_was_written():
    seen = case([NOTHING, DRAG, BOTH], usual=(0.1, 0.02))
    line = json.dumps(seen.to_dict())
    assert CaseEvidence.from_dict(json.loads(line)) == seen
    content = json.loads(line)
    assert content["usual"] == [0.1, 0.02]
    assert content["hypotheses"][1]["varies"] == {"viscous_drag": ["vx", 0.0, 0.0]}
    for h in content["hypotheses"]:  # as in ledgers of earlier cases
        del h["correlation"], h["by_condition"]
    assert CaseEvidence.from_dict(content) == seen
    del content["hypotheses"][0]["excess"]
    with pytest.raises(KeyError, match="excess"):
        CaseEvidence.from_dict(content)


def test_a_line_has_so_many_digits_of_a_number_and_no_more():
    seen = case([replace(NOTHING, z=(1 / 3,), varies={}), DRAG], first=2 / 3).rounded
    assert seen.first == 0.66667
    assert seen.null.z == (0.33333,)
    assert seen.rounded == seen


def test_what_the_best_leaves_speaks_for_unknown_physics():
    closed = of_case(case([NOTHING, DRAG]))
    left = of_case(case([NOTHING, replace(DRAG, excess=0.5)]))
    assert left["share"] > closed["share"]
    assert left["first"] == closed["first"]


def test_what_remains_in_one_channel_and_what_was_gained_are_of_the_case():
    even = of_case(case([NOTHING, DRAG]))
    one = of_case(case([NOTHING, replace(DRAG, channel=(0.0, 0.0, 0.0, 0.0, 0.1, 0.9))]))
    assert even["channel"] == pytest.approx(1 / 6)
    assert one["channel"] == 0.9
    assert even["gained"] == one["gained"] == pytest.approx(math.log1p(65 / 4))
    # Nothing leads and nothing is left.
    none = of_case(case([replace(NOTHING, channel=(0.0,) * 6)]))
    assert (none["gained"], none["channel"]) == (0, 0)


def test_a_calibration_is_read_from_its_file(tmp_path):
    file = tmp_path / "calibration.yaml"
    file.write_text(
        "hypothesis: {ratio: 1.0}\nunknown: {one: -2.0}\nform_error: {always: 0.1, remains: 0.2}\n"
        "made_from: {cases: 3}\n"
    )
    form = FormError(1.0, 0.1, 0.2)
    expected = Calibration({"ratio": 1.0}, {"one": -2.0}, form, 3, step_error=form)
    assert load_calibration(file) == expected


def test_no_answer_is_surer_than_the_cases_can_tell():
    sure = posterior(case([NOTHING, DRAG]), BY_LOSS)
    assert sure.of("viscous_drag") > 0.9999
    few = posterior(
        case([NOTHING, DRAG]), Calibration(BY_LOSS.hypothesis, BY_LOSS.unknown, cases=48)
    )
    assert few.of("viscous_drag") == pytest.approx(0.98 * sure.of("viscous_drag"))
    assert few.unknown == pytest.approx(0.02 + 0.98 * sure.unknown)
    assert sum(few.sets.values()) + few.unknown == pytest.approx(1.0)


def test_a_set_that_was_asked_for_can_be_the_answer_and_its_numbers_may_vary():
    """As `tire_grip`, fitted for a patch that turned out to be the whole floor."""
    varies = {"wind": Variation("speed", 0.5, 0.5)}
    asked = replace(OTHER, asked=True, varies=varies)
    assert varying(case([NOTHING, DRAG, asked]), ("wind",)) == {"wind": "speed"}
    assert varying(case([NOTHING, DRAG, asked]), ("viscous_drag",)) == {}


def test_the_second_evidence_tells_of_the_best_set_and_of_the_least_needed_effect():
    nats = {(): -120.0, ("drag",): -20.0, ("drag", "wind"): 0.0, ("wind",): -100.0}
    known = [hypothesis(effects, [1.0, 1.0], 0.1, changed=n) for effects, n in nats.items()]
    found = dict(zip(nats, of_hypotheses(case(known, usual=(0.0, 0.1))), strict=True))
    both = found["drag", "wind"]
    assert both["changed"] == 0.0
    assert both["changed_needed"] == pytest.approx(math.log1p(20 / 4))
    assert found["drag",]["changed"] == pytest.approx(-math.log1p(20 / 4))
    assert found["wind",]["changed_needed"] < 0  # {drag}, without it, is better
    assert found[()]["changed_needed"] == 0.0
    assert both["needed_since"] == both["changed_needed"]
    alone = of_hypotheses(case(known))[2]
    assert alone["changed_needed"] == both["changed_needed"]
    assert alone["needed_since"] == 0.0
    assert of_case(case(known))["changed"] == pytest.approx(math.log1p(120 / 4))


def test_a_ledger_without_the_second_evidence_has_none_of_its_features():
    found = of_hypotheses(case([NOTHING, DRAG]))
    assert all(f["changed"] == f["changed_needed"] == 0.0 for f in found)
    assert of_case(case([NOTHING, DRAG]))["changed"] == 0.0
