import json
import math
from dataclasses import replace

import pytest

from buggy_rl.diagnosis.answer.answer import Answer, Proof, describe_unexplained
from buggy_rl.diagnosis.answer.behaviour import Behaviour, FormFault
from buggy_rl.diagnosis.answer.equivalents import Equivalents
from buggy_rl.diagnosis.answer.experiments import DecisionRate
from buggy_rl.diagnosis.answer.located import Interval, Located, Region
from buggy_rl.diagnosis.answer.named_effect import NamedEffect, Value, sentence
from buggy_rl.diagnosis.answer.retuning import left_open
from buggy_rl.diagnosis.residuals import Unexplained
from buggy_rl.diagnosis.search.posterior import Posterior

# Contract 3: what must be there, and of which type; a list holds any number of its one element.
SCHEMA = {
    "schema": int,
    "verdict": str,
    "located": {
        "channel_share": {"vx": float, "vy": float, "yaw_rate": float},
        "regions": [{"where": dict, "error_share": float, "data_share": float}],
        "intervals": [{"recording": str, "from": float, "to": float, "error_share": float}],
    },
    "effects": [
        {
            "name": str,
            "kind": str,
            "equation": str,
            "parameters": dict,
            "confidence": float,
            "held_out_gain": float,
            "confused_with": [{"name": str, "confidence": float}],
        }
    ],
    "unexplained": {"share": float, "depends_on": list, "description": str},
    "fit": {
        "metric": str,
        "before": float,
        "after": float,
        "noise_floor": float,
        "held_out": bool,
        "position_mse_before": float,
        "position_mse_after": float,
    },
    "excitation": {"weak": [str], "suggest": [str]},
}
EITHER = Equivalents(
    effects=("steering_dead_time", "steering_lag"),
    probability=0.97,
    shares=(0.55, 0.41),
    nats=3.2,
    sentences=("the steering takes effect 61 ms late", "the wheels turn gradually"),
    decided_by="slalom",
)


def broken(value, schema, where="answer"):
    """Where a value does not match a schema."""
    if isinstance(schema, dict):
        missing = [f"{where}.{key} is missing" for key in schema if key not in value]
        return missing + [
            fault
            for key, inner in schema.items()
            if key in value
            for fault in broken(value[key], inner, f"{where}.{key}")
        ]
    if isinstance(schema, list):
        if not isinstance(value, list):
            return [f"{where} is no list"]
        return [
            fault
            for index, item in enumerate(value)
            for fault in broken(item, schema[0], f"{where}[{index}]")
        ]
    return [] if isinstance(value, schema) else [f"{where} is {value!r}, no {schema.__name__}"]


def an_answer(**changes):
    named = NamedEffect(
        "steering_dead_time",
        "actuation",
        "u'(t) = u(t - dead_time)",
        "the steering takes effect 61 ms late",
        {"dead_time": Value(0.061, 0.055, 0.067, "s")},
        0.98,
        0.83,
        {"steering_lag": 0.02},
    )
    located = Located(
        {"vx": 0.1, "vy": 0.2, "yaw_rate": 0.7},
        [Region({"vx": (2.0, 3.4)}, 0.81, 0.22)],
        [Interval("drive_0", 12.3, 14.0, 0.3)],
        {"throttle": {"vx": float("nan")}, "steering": {"yaw_rate": 0.06}},
    )
    proof = Proof(
        before={0.3: 0.001, 1.0: 0.04},
        after={0.3: 0.0001, 1.0: 0.0009},
        retuned={},
        noise_floor={1.0: 1e-6},
        black_box={1.0: math.inf},
        misfit_before=5.0,
        misfit_after=1.1,
        held_out=True,
        median={"before": {1.0: 0.15}, "after": {0.3: 0.001, 1.0: 0.02}},
    )
    rest = Unexplained(0.3, 0.06, {"vx": 0.9, "yaw_rate": 0.1}, ["vx", "steering"], True)
    parts = {"verdict": "missing_physics", "located": located, "effects": [named]}
    parts |= {"remaining": rest, "proof": proof, "weak": ["x hardly driven"], "suggest": ["y"]}
    return Answer(**(parts | changes))


def test_effects_that_cannot_be_told_apart_are_one_finding():
    said = an_answer(equivalents=[EITHER])
    content = said.to_dict()
    assert broken(content, SCHEMA) == []
    [either] = content["equivalents"]
    assert either == {
        "effects": ["steering_dead_time", "steering_lag"],
        "probability": 0.97,
        "shares": [0.55, 0.41],
        "nats": 3.2,
        "decided_by": "slalom",
    }
    assert [e["name"] for e in content["effects"]] == ["steering_dead_time"]  # as it was
    [line] = [line for line in said.lines() if "61 ms" in line]
    assert line == (
        "Either the steering takes effect 61 ms late, or the wheels turn gradually: these "
        "recordings cannot tell [steering_dead_time 55%, steering_lag 41%, together 97%]."
    )
    open_ = an_answer(equivalents=[replace(EITHER, decided_by="")]).lines()
    assert any("no manoeuvre known here is expected to decide" in line for line in open_)


def test_how_an_effect_is_realised_and_what_manoeuvres_decide_is_added_to_the_contract():
    rate = DecisionRate("slalom", "a slalom", 0.87, 0.93, (("steering_lag",), ()))
    content = an_answer(manoeuvres=[rate]).to_dict()
    assert content["effects"][0]["realised"] == "effect"
    assert content["excitation"]["manoeuvres"] == [
        {
            "manoeuvre": "slalom",
            "words": "a slalom",
            "rate": 0.87,
            "expected": 0.93,
            "between": [["steering_lag"], []],
        }
    ]
    named = an_answer().effects[0]
    assert replace(named, inside=("a", "b")).realised == "parameters a, b"


def test_the_answer_is_as_the_contract_has_it():
    content = an_answer().to_dict()
    assert broken(content, SCHEMA) == []
    assert content["schema"] == 1
    assert content["located"]["regions"][0]["where"] == {"vx": [2.0, 3.4]}
    interval = {"recording": "drive_0", "from": 12.3, "to": 14.0, "error_share": 0.3}
    assert content["located"]["intervals"] == [interval]
    [effect] = content["effects"]
    value = {"value": 0.061, "low": 0.055, "high": 0.067, "unit": "s"}
    assert effect["parameters"] == {"dead_time": value}
    assert effect["confused_with"] == [{"name": "steering_lag", "confidence": 0.02}]


def test_a_fault_of_the_answer_is_found():
    content = an_answer().to_dict()
    del content["fit"]["before"]
    content["effects"][0]["confidence"] = "high"
    assert broken(content, SCHEMA) == [
        "answer.effects[0].confidence is 'high', no float",
        "answer.fit.before is missing",
    ]


def test_the_answer_is_strict_json_with_null_for_what_is_not_finite():
    content = an_answer().to_dict()
    text = json.dumps(content, allow_nan=False)
    assert json.loads(text) == content
    assert content["located"]["lags"]["throttle"]["vx"] is None
    assert content["fit"]["position_mse"]["black_box"] == {"1 s": None}


def test_a_misspecified_effect_is_said_to_be_one():
    [named] = an_answer().effects
    misspecified = replace(named, varies_with="vx", confidence=0.3)
    lines = an_answer(verdict="unknown_physics", effects=[misspecified]).lines()
    assert lines[0].startswith("Physics is missing that no effect in the library describes; ")
    assert "varies with speed: probably misspecified" in lines[2]
    other = an_answer(verdict="unknown_physics", effects=[misspecified, named]).lines()
    assert other[0].startswith("What is named here explains")


@pytest.mark.parametrize(
    "verdict",
    ["missing_physics", "wrong_parameters", "unknown_physics", "no_mismatch", "cannot_tell"],
)
def test_every_verdict_has_a_first_line_of_its_own(verdict):
    lines = an_answer(verdict=verdict).lines()
    others = {an_answer(verdict=v).lines()[0] for v in ("no_mismatch", "cannot_tell")}
    assert lines[0].endswith(".")
    assert verdict in ("no_mismatch", "cannot_tell") or lines[0] not in others


def test_the_lines_say_channel_effect_confidence_and_improvement():
    # Roots of the mean squares: sqrt(0.04) = 200 mm, sqrt(0.0009) = 30 mm.
    assert an_answer().lines() == [
        "Physics is missing from the simulator.",
        "The largest share of the error is in yaw rate (70%).",
        "The steering takes effect 61 ms late "
        "[steering_dead_time, confidence 98%; alternatives: steering_lag (2%)].",
        "Position error of 1 s rollouts on held-out data: median 150 mm before, 20 mm after; "
        "root mean square 200 mm before, 30 mm after.",
        "Drive next: y.",
    ]


@pytest.mark.parametrize(
    ("verdict", "share", "line"),
    [
        ("missing_physics", 0.42, "Physics is missing from the simulator; 42% of the residual is "
         "unexplained."),
        ("wrong_parameters", 0.29, "The simulator's parameters are wrong; 29% of the residual is "
         "unexplained."),
        ("wrong_parameters", 0.05, "The simulator's parameters are wrong; no physics is missing."),
        ("unknown_physics", 0.6, "What is named here explains 40% of the residual; the rest has a "
         "form that no effect in the library has."),
    ],
)  # fmt: skip
def test_the_first_line_says_what_is_unexplained(verdict, share, line):
    rest = Unexplained(1.0, share, {"vx": 1.0}, [], False)
    assert replace(an_answer(verdict=verdict), remaining=rest).lines()[0] == line


def test_an_improbable_effect_is_not_said_where_something_has_no_name():
    first = an_answer().effects[0]
    unlikely = replace(first, confidence=0.02)
    answer = an_answer(verdict="unknown_physics", effects=[unlikely])
    lines = answer.lines()
    assert lines[0] == "Physics is missing that no effect in the library describes."
    assert not any(first.name in line for line in lines)
    assert answer.to_dict()["effects"][0]["name"] == first.name
    said = an_answer(verdict="unknown_physics", effects=[replace(first, confidence=0.06)]).lines()
    assert any(first.name in line for line in said)
    said = an_answer(verdict="missing_physics", effects=[unlikely]).lines()
    assert any(first.name in line for line in said)


def test_the_unexplained_residual_is_described_and_never_named():
    assert (
        describe_unexplained(Unexplained(0.05, 0.0, {"vx": 1.0}, ["vx"], True))
        == "What remains is noise."
    )
    assert an_answer().to_dict()["unexplained"]["description"] == (
        "The unexplained residual is largest in vx; it grows with vx and steering; it persists "
        "over time, as with a latent state."
    )


def test_a_parameter_of_the_simulators_own_is_said_in_words():
    words = sentence("parameter:drive_force", {"drive_force": 4.0}, "N", 6.5)
    assert words == "the simulator's drive force is 4 N, not 6.5"


def test_of_many_effects_five_get_a_sentence_and_the_others_are_listed():
    answer = an_answer()
    many = [replace(answer.effects[0], name=f"effect_{i}") for i in range(7)]
    lines = replace(answer, effects=many).lines()
    assert sum("[effect_" in line for line in lines) == 5
    assert "And effect_5, effect_6: see the report." in lines


def test_a_ratio_has_no_unit():
    said = sentence("parameter:throttle_deadband", {"throttle_deadband": 0.1}, "-", 0.05)
    assert said == "the simulator's throttle deadband is 0.1, not 0.05"
    said = sentence("parameter:mass", {"mass": 2.0}, "kg", 1.6)
    assert said == "the simulator's mass is 2 kg, not 1.6"


def test_an_open_answer_begins_with_what_differs_and_ends_with_what_remains():
    late = Behaviour(
        "steering_response", "to half of the yaw rate", "s", 0.08, 0.14, 0.13, 0.15, True
    )
    same = replace(late, name="coasting", differs=False)
    own = replace(
        an_answer().effects[0],
        name="parameter:mass",
        kind="parameter",
        sentence="the simulator's mass is 2 kg, not 1.6",
        parameters={"mass": Value(2.0, 1.9, 2.1, "kg")},
        confidence=0.4,
        confused_with={},
    )
    inertia = replace(own, parameters={"yaw_inertia": Value(0.01, 0.005, 0.02, "kg m^2")})
    answer = an_answer(
        verdict="unknown_physics",
        effects=[own, inertia],
        behaviours=[same, late],
        form=[FormFault("vx", "vx", 1.0, 2.0, 0.1)],
        suggest=[],
    )
    median = {**answer.proof.median, "retuned": {1.0: 0.03}, "black_box": {1.0: 0.1}}
    answer = replace(answer, proof=replace(answer.proof, median=median))
    assert answer.lines() == [
        "What is named here explains 94% of the residual; the rest has a form that no effect in "
        "the library has.",
        "Whatever is to blame: to half of the yaw rate: car 140 ms (130 to 150), simulator 80 ms.",
        "The largest share of the error is in yaw rate (70%).",
        "Parameters that are off where all are re-tuned (with a probability of 60% more is missing "
        "than they say): mass 2 kg (1.9 to 2.1), not 1.6; yaw inertia 0.01 kg m^2 (0.005 to 0.02), "
        "not 1.6.",
        "Where the repaired simulator is still wrong: speed 0.1 m/s too high (median) at speed 1 "
        "to 2 m/s.",
        "Position error of 1 s rollouts on held-out data: median 150 mm before, 20 mm after; "
        "root mean square 200 mm before, 30 mm after.",
        "In comparison, median: 30 mm re-tuned alone, 100 mm with a learned residual.",
        "Hardly driven: x hardly driven.",
    ]
    content = answer.to_dict()
    assert broken(content, SCHEMA) == []
    assert [b["differs"] for b in content["behaviours"]] == [False, True]
    assert content["unexplained"]["form"][0]["channel"] == "vx"


def test_a_better_proof_leaves_less_in_noise_units_and_in_metres():
    def left(misfit, metres):
        proof = an_answer().proof
        return replace(proof, misfit_after=misfit, median={"after": {0.3: 9.0, 1.0: metres}})

    assert left(2.0, 0.1).better_than(left(3.0, 0.2))
    assert not left(2.0, 0.3).better_than(left(3.0, 0.2))
    assert not left(3.0, 0.1).better_than(left(2.0, 0.2))


@pytest.mark.parametrize(
    ("median", "mean_square", "expected"),
    [(0.03, 0.004, True), (0.03, 0.02, False), (0.06, 0.004, False), (0.05, 0.01, False)],
)
def test_fitted_parameters_are_preferred_where_both_of_their_errors_are_smaller(
    median, mean_square, expected
):
    after, tuned = {1.0: 0.01}, {1.0: mean_square}
    of = {"after": {1.0: 0.05}, "retuned": {1.0: median}}
    proof = Proof({1.0: 0.1}, after, tuned, {}, {}, 5.0, 1.0, True, of)
    assert proof.prefers_retuning is expected
    assert not replace(proof, median={}).prefers_retuning  # nothing was told at that horizon


@pytest.mark.parametrize(
    ("sets", "unknown", "tuned_better", "expected"),
    [
        ({(): 0.01, ("payload",): 0.58}, 0.41, True, True),
        ({(): 0.01, ("payload",): 0.58}, 0.41, False, False),
        ({(): 0.01, ("payload",): 0.95}, 0.04, True, False),  # sure enough
        ({(): 0.01, ("payload",): 0.19}, 0.80, False, True),
    ],
)
def test_a_second_search_where_unknown_or_unsure_and_parameters_alone_do_better(
    sets, unknown, tuned_better, expected
):
    tuned = 0.03 if tuned_better else 0.06
    of = {"after": {1.0: 0.05}, "retuned": {1.0: tuned}}
    proof = Proof({1.0: 0.1}, {1.0: 0.01}, {1.0: tuned**2}, {}, {}, 5.0, 1.0, True, of)
    assert left_open(Posterior(sets, unknown), ("payload",), proof) is expected


def test_a_manoeuvre_says_between_which_sets_it_decides():
    rate = DecisionRate("slalom", "a slalom", 0.87, 0.93, (("steering_lag", "wind"), ()))
    assert "between steering_lag+wind and nothing with a probability of 87%" in rate.line()
