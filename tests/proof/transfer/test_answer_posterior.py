"""A repaired simulator whose environments differ within the intervals of fit and answer."""

import json

import pytest
import torch
import yaml
from torchrl.envs import TransformedEnv

from buggy_rl.proof.transfer.answer_posterior import repaired_with_spread
from buggy_rl.simulators.base import Engine

CARS = 400
FITTED = {
    "engine": "single_track",
    "parameters": {"mass": 2.0, "front_grip": 0.6, "rear_grip": 0.8, "drive_force": 10.0},
    "_fit": {
        "front_grip": {"low": 0.5, "high": 0.65},
        "rear_grip": {"low": 0.8, "high": 0.8},
        "drive_force": {"low": 9.0, "high": 11.0},
    },
}


def number(value, low, high):
    return {"value": value, "low": low, "high": high, "unit": "-"}


def said(name, **numbers):
    return {"name": name, "parameters": numbers}


def drawn(tmp_path, named, **repair):
    (tmp_path / "fitted.yaml").write_text(yaml.safe_dump(FITTED))
    repaired, answer = tmp_path / "repaired.yaml", tmp_path / "diagnosis.json"
    repaired.write_text(yaml.safe_dump({"engine": "fitted.yaml", **repair}))
    answer.write_text(json.dumps({"effects": named}))
    torch.manual_seed(0)
    return repaired_with_spread(repaired, tmp_path / "fitted.yaml", answer, CARS)


def values(tmp_path, named=(), **repair):
    engine = drawn(tmp_path, list(named), **repair)
    assert isinstance(engine, Engine)
    return engine.values


def spans(values, low, high):
    """Even draws: of 400 the outermost are within 3 % of the ends but in 1 of 1e5 cases."""
    slack = 0.03 * (high - low)
    assert low - 1e-6 <= float(values.min()) < low + slack
    assert high - slack < float(values.max()) <= high + 1e-6


def test_parameters_are_drawn_from_twice_the_fits_intervals_about_their_repaired_values(tmp_path):
    found = values(tmp_path, parameters={"front_grip": 0.4})
    # About 0.6 the interval is -0.1 to +0.05: twice that about 0.4.
    spans(found["front_grip"], 0.2, 0.5)
    spans(found["drive_force"], 8.0, 12.0)
    assert found["mass"].unique().tolist() == [2.0]


def test_a_parameter_of_which_the_fit_warns_stays_where_it_is(tmp_path, monkeypatch):
    warned = {"low": 0.5, "high": 0.65, "warnings": ["these drives do not determine it"]}
    monkeypatch.setitem(FITTED["_fit"], "front_grip", warned)
    found = values(tmp_path, parameters={"front_grip": 0.4})
    assert found["front_grip"].unique().tolist() == [pytest.approx(0.4)]
    spans(found["drive_force"], 8.0, 12.0)


def test_a_parameter_that_the_answer_names_is_drawn_from_its_interval(tmp_path):
    own = said("parameter:front_grip", front_grip=number(0.4, 0.35, 0.5))
    spans(values(tmp_path, [own], parameters={"front_grip": 0.4})["front_grip"], 0.35, 0.5)


def test_an_effect_that_is_realised_inside_is_drawn_by_its_number(tmp_path):
    grip = said("tire_grip", grip=number(0.5, 0.4, 0.6))
    found = values(tmp_path, [grip], parameters={"front_grip": 0.3, "rear_grip": 0.4})
    # The rear grip of the fit has no width: 0.4 times 0.4 / 0.5 to 0.6 / 0.5.
    spans(found["rear_grip"], 0.32, 0.48)


def test_an_effect_that_was_not_delivered_changes_nothing(tmp_path):
    grip = said("tire_grip", grip=number(0.5, 0.4, 0.6))
    assert values(tmp_path, [grip])["rear_grip"].unique().tolist() == [pytest.approx(0.8)]


def test_numbers_of_effects_and_terms_are_drawn_from_their_intervals(tmp_path):
    lag = said("steering_lag", time_constant=number(0.1, 0.05, 0.12))
    term = said("term.yaw.throttle", coefficient=number(1.0, 0.5, 2.0))
    effects = {
        "steering_lag": {"time_constant": 0.1},
        "term.yaw.throttle": {"coefficient": 1.0},
    }
    env = drawn(tmp_path, [lag, term], effects=effects)
    assert isinstance(env, TransformedEnv)
    found = {effect.name: effect.values for effect in env.transform}
    spans(found["steering_lag"]["time_constant"], 0.05, 0.12)
    spans(found["term.yaw.throttle"]["coefficient"], 0.5, 2.0)
