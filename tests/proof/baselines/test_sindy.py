"""Sparse regression over the library's columns."""

import sys

import numpy as np
import pytest
import torch

from buggy_rl.effects import effect_class
from buggy_rl.estimation.hypothesis import Library
from buggy_rl.proof.baselines.columns import DELAYS, Columns, Feature
from buggy_rl.proof.baselines.sindy import numbers, sindy, sparse
from tests.proof.baselines import synthetic as made
from tests.proof.baselines.folder import shown


def synthetic_delays() -> Columns:
    """Features of a late steering, without columns."""
    coordinates = Library().hypothesis(["steering_dead_time"]).coordinates[:-1]
    size = coordinates[0].parameter.size
    features = [
        Feature("steering_dead_time", coordinates, (delay / size,), (True,), False)
        for delay in DELAYS
    ]
    return Columns(features, torch.zeros(1, 1, 6), torch.zeros(5, 1, 1, 6))


MODULE = "buggy_rl.proof.baselines.sindy"


@pytest.fixture
def answer(answering):
    """Answers to columns that are known."""
    pytest.importorskip("pysindy")
    return answering(MODULE, sindy)


def test_the_largest_standardised_coefficient_is_named_with_its_size(answer):
    said = answer(made.synthetic([0.3, 0.9, 0.0]))
    effect = said["effects"][0]
    assert (said["verdict"], effect["name"]) == ("missing_physics", "viscous_drag")
    size = effect_class("viscous_drag").declared[0].size
    rate = effect["parameters"]["rate"]
    assert rate["low"] < 0.9 * size < rate["high"]
    assert rate["high"] - rate["low"] < 0.15 * size
    # Its share of the squares is 0.81 / (0.81 + 0.09).
    assert effect["confidence"] == pytest.approx(0.9, abs=0.03)


def test_what_is_fainter_than_a_tenth_of_its_size_is_dropped(answer):
    assert answer(made.synthetic([0.05, 0.0, 0.0]))["verdict"] == "no_mismatch"


def test_a_negative_lag_is_left_out_and_the_rest_regressed_again():
    pytest.importorskip("pysindy")
    found = made.synthetic([0.5, 0.0, -0.8])
    x, y = found.explained.flatten(1).T.numpy(), found.lacking.flatten().numpy()
    free = sparse(x, y, [True, True, True])
    np.testing.assert_allclose(free, [0.5, 0.0, -0.8], atol=0.05)
    kept = sparse(x, y, [True, True, False])
    np.testing.assert_allclose(kept, [0.5, 0.0, 0.0], atol=0.05)
    assert not sparse(x[:, 2:], y, [False]).any()


def test_a_column_that_is_not_excited_has_no_coefficient():
    pytest.importorskip("pysindy")
    x = np.stack([np.zeros(100), np.linspace(-1, 1, 100)], 1)
    np.testing.assert_allclose(sparse(x, 2 * x[:, 1], [True, True]), [0.0, 2.0], atol=0.01)


def test_without_pysindy_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pysindy", None)
    with pytest.raises(ImportError, match=r"pip install 'buggy_rl\[proof\]'"):
        sparse(np.ones((3, 1)), np.ones(3), [True])


def test_columns_of_several_delays_add_up():
    segments = synthetic_delays()
    coefficients = np.array([0.0, 0.5, 0.5, 0.0, 0.0])
    said = numbers(segments, coefficients, np.full(5, 0.1), "steering_dead_time")["dead_time"]
    # 0.5 * 0.06 + 0.5 * 0.09 s, within 1.96 * 0.1 * sqrt(sum of the squared delays) = 0.0436 s.
    assert said["value"] == pytest.approx(0.075, abs=1e-6)
    assert said["low"] == pytest.approx(0.075 - 0.0436, abs=2e-4)


def test_a_late_steering_is_named_with_its_delay(drives, tmp_path):
    pytest.importorskip("pysindy")
    effects = ["steering_dead_time", "steering_gain", "throttle_dead_time", "viscous_drag"]
    said = sindy(shown(tmp_path, drives["late"], effects=effects))
    assert said["effects"][0]["name"] == "steering_dead_time"
    value = said["effects"][0]["parameters"]["dead_time"]["value"]
    assert value == pytest.approx(0.11, abs=0.02)


def test_drag_of_a_car_is_named(drives, tmp_path):
    pytest.importorskip("pysindy")
    effects = ["viscous_drag", "steering_gain", "throttle_lag"]
    said = sindy(shown(tmp_path, drives["draggy"], effects=effects))
    assert said["effects"][0]["name"] == "viscous_drag"
    assert said["effects"][0]["parameters"]["rate"]["value"] == pytest.approx(0.8, rel=0.2)
