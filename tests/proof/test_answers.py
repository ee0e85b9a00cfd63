"""Figures of answers: names over strength, terms, what else is missing, repaired simulators."""

from dataclasses import asdict, replace

import pytest

from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.score.answers import (
    WeighedAnswer,
    answer_rows,
    more_by_difference,
    named_curve,
    stack_by_family,
)
from buggy_rl.proof.score.figures import share
from buggy_rl.proof.score.outcome import CaseAnswer, ScoredCase, ScoredEffect
from buggy_rl.proof.score.stack import StackErrors
from buggy_rl.proof.score.terms import TermMatch

GAIN, OFFSET, LAG = {"gain": 0.8}, {"offset": 0.1}, {"time_constant": 0.1}
TERM = "term.forward.steering"


def answered(concealed, said, simulator="reference", baseline=False, more=None, **known):
    """A case of the reference car and an answer: effect -> probability."""
    case = Case(1, "reference", simulator, baseline, concealed)
    effects = tuple(ScoredEffect(name, p) for name, p in said.items())
    answer = CaseAnswer("missing_physics", effects, more=more)
    return WeighedAnswer(ScoredCase(case, answer), **known)


def value(cases, name):
    """A figure by the beginning of its name."""
    [row] = [row for row in answer_rows(cases) if row.name.startswith(name)]
    return row.figure.value, row.figure.count


def test_names_count_from_one_half_on():
    cases = [
        answered({"steering_gain": GAIN}, {"steering_gain": 0.9, "steering_offset": 0.4}),
        answered({"steering_gain": GAIN}, {"steering_offset": 0.6}),
        answered({}, {"payload": 0.7}),
    ]
    assert value(cases, "names above one half") == (pytest.approx(1 / 3), 3)
    assert value(cases, "nothing concealed") == (1.0, 1)


def test_a_name_for_what_no_effect_describes_is_wrong_among_all_cases():
    cases = [
        answered({"steering_gain": GAIN}, {"steering_gain": 0.9}),
        answered({"sticky_servo": {"band": 0.1}}, {"steering_gain": 0.9}),
    ]
    assert value(cases, "names above one half") == (1.0, 1)
    assert value(cases, "  of all cases") == (0.5, 2)


def test_names_that_were_considered_count_beside_those_in_the_answer():
    case = answered({"steering_lag": LAG}, {"steering_lag": 0.8})
    assert value([case], "Brier score of the names in the answer")[0] == pytest.approx(0.04)
    assert not [r for r in answer_rows([case]) if r.name.startswith("Brier score of all")]
    sets = [
        {"effects": ["steering_lag"], "probability": 0.6},
        {"effects": ["parameter:steering_lag", "payload"], "probability": 0.2},
    ]
    about = {"status": "answered", "seconds": 1.0}
    said = CaseAnswer.from_diagnosis({"posterior": {"sets": sets}}, about)
    assert said.mentioned == {"steering_lag": 0.8, "payload": 0.2}
    assert CaseAnswer.from_dict(asdict(said)) == said
    case = replace(case, scored=replace(case.scored, answer=said))
    assert value([case], "Brier score of all")[0] == pytest.approx((0.04 + 0.04) / 2)


def test_cases_of_one_make_and_simulator_are_a_cluster_with_a_baseline_or_without():
    right, wrong = {"steering_gain": 0.9}, {"steering_offset": 0.9}

    def interval(makes, said):
        cases = [
            answered({"steering_gain": GAIN}, s, simulator, baseline=i % 2 == 0)
            for i, (simulator, s) in enumerate(zip(makes, said, strict=True))
        ]
        [row, *_] = answer_rows(cases)
        return row.figure

    said = [right] * 6 + [wrong] * 6
    alike = interval(["reference"] * 6 + ["learned"] * 6, said)
    mixed = interval(["reference", "learned"] * 6, said)
    assert alike.value == mixed.value == 0.5
    assert mixed == share([True] * 6 + [False] * 6)
    assert alike.low < mixed.low
    assert alike.high > mixed.high


def test_a_term_is_no_name_of_the_library():
    assert answered({}, {TERM: 0.9}).given == []


def test_only_what_is_strong_enough_has_to_be_named():
    both = {"steering_gain": GAIN, "steering_offset": OFFSET}
    strength = {"steering_gain": 50.0, "steering_offset": 5.0}
    cases = [
        answered(both, {"steering_gain": 0.8}, strength=strength),
        answered({"steering_gain": GAIN}, {}, strength={"steering_gain": 7.0}),
    ]
    assert value(cases, "  of two and three") == (1.0, 1)
    assert value(cases, "effects above 6 nats") == (0.0, 1)
    [row] = named_curve(cases, [6.0])
    assert (row.recall.value, row.recall.count) == (0.5, 2)
    assert row.precision.count == 0  # the pair has one that is too faint


def composed(low, high, said=TERM, misfit=0.01):
    """A case whose physics is a term, and an answer that says one."""
    match = TermMatch(TERM, misfit, 0.5, alike=misfit < 0.05)
    case = Case(1, "reference", "reference", concealed={"forward.steering.linear.none": {}})
    number = {"coefficient": {"value": (low + high) / 2, "low": low, "high": high}}
    answer = CaseAnswer("missing_physics", (ScoredEffect(said, 0.5, number),))
    return WeighedAnswer(ScoredCase(case, answer), strength={TERM: 20.0}, terms={match.name: match})


def test_a_term_is_found_by_its_name_and_its_interval_by_the_coefficient():
    cases = [
        composed(0.4, 0.6),
        composed(0.6, 0.8),
        composed(0.4, 0.6, said="term.forward.yaw_rate"),
    ]
    assert value(cases, "in the grammar: term found") == (pytest.approx(2 / 3), 3)
    assert value(cases, "  its interval") == (0.5, 2)


def test_what_the_grammar_has_not_is_outside():
    case = composed(0.4, 0.6, misfit=0.4)
    assert case.family == "unknown"
    assert value([case], "outside of it: an effect named") == (0.0, 1)


def test_more_is_missing_by_what_differs_beside_the_effects():
    gain, odd = {"steering_gain": GAIN}, {"sticky_servo": {"band": 0.1}}
    cases = [
        answered(odd, {}, more=0.9, simulator="mujoco"),
        answered(gain, {}, more=0.9, simulator="mujoco"),
        answered(gain, {}, more=0.1, simulator="mujoco", baseline=True),
        answered(gain, {}, more=0.5, simulator="mujoco", baseline=True),
        answered(gain, {}),
    ]
    physics, unseen, seen = more_by_difference(cases)
    assert "physics" in physics.kind
    assert "no baseline" in unseen.kind
    assert "with a baseline" in seen.kind
    assert [(r.surely.value, r.hardly.value) for r in (physics, unseen)] == [(1.0, 0.0)] * 2
    assert (seen.surely.value, seen.hardly.value, seen.surely.count) == (0.0, 0.5, 2)


def test_what_differs_in_a_car_of_the_simulators_own_make():
    exact = answered({}, {}, more=0.9)
    others = [
        replace(exact, scored=replace(exact.scored, case=replace(exact.scored.case, **change)))
        for change in ({"spread": 0.08}, {"nuisance": "parameters_3"}, {"nuisance": "integrator"})
    ]
    numbers, nothing = more_by_difference([exact, *others])
    assert (numbers.kind.split(":")[0], numbers.surely.count) == ("numbers", 2)
    # A car that was drawn has a simulator of its own numbers.
    assert (nothing.kind.split(":")[0], nothing.surely.count) == ("nothing", 2)


def errors(stack, residual, farther=0.0, error=1.0, given=0.1, floor=0.004):
    """Distances of a case."""
    names = {"as_given": given, "retuned": 0.09, "residual": residual, "stack": stack}
    more = {name: (farther, error) for name in ("as_given", "retuned", "residual")}
    return StackErrors(names, more, floor)


def test_a_gap_is_closed_down_to_what_a_simulator_without_fault_has():
    assert errors(0.052, 0.1).closed() == pytest.approx(0.5)
    assert errors(0.004, 0.1).closed() == pytest.approx(1.0)
    assert not errors(0.004, 0.1, given=0.005).seen


def test_a_stack_is_beaten_only_where_another_is_nearer_surely():
    assert errors(0.05, 0.02, farther=0.9, error=0.1).beaten
    assert not errors(0.05, 0.02, farther=0.9, error=0.6).beaten
    assert not errors(0.02, 0.0195, farther=0.9, error=0.1).beaten


def test_without_an_answer_an_effect_is_missed_and_nothing_wrong_is_said():
    unknown = {"sticky_servo": {"band": 0.1}}
    cases = [answered({"steering_gain": GAIN}, {}, strength={"steering_gain": 50.0})]
    cases += [answered(concealed, {}) for concealed in ({}, unknown)]
    silent = [
        replace(c, scored=replace(c.scored, answer=replace(c.scored.answer, status="crashed")))
        for c in cases
    ]
    assert value(silent, "effects above 6 nats") == (0.0, 1)
    assert value(cases, "nothing concealed")[1] == value(cases, "outside of it")[1] == 1
    assert value(silent, "nothing concealed")[1] == value(silent, "outside of it")[1] == 0
    assert value(silent, "no answer") == (1.0, 3)


def test_repaired_simulators_are_counted_by_what_is_concealed():
    near, far = (
        StackErrors(
            {"as_given": 1.1, "stack": stack, "retuned": 0.6, "residual": 1.1},
            {"as_given": (-1.0, 0.1), "retuned": (more, 0.1), "residual": (-1.0, 0.1)},
            0.1,
        )
        for stack, more in ((0.2, -1.0), (1.0, 0.5))
    )
    gain = {"steering_gain": GAIN}
    cases = [answered(gain, {}, stack=near), answered({}, {}, stack=far), answered(gain, {})]
    none, one = stack_by_family(cases)
    assert (none.family, one.family) == ("nothing", "one effect")
    assert (one.closed.value, one.closed.count) == (pytest.approx(0.9), 1)
    assert (one.retuned.value, one.residual.value) == (pytest.approx(0.5), 0.0)
    assert (one.beaten.value, none.beaten.value) == (0.0, 1.0)
