"""The largest correlation, above chance."""

import pytest
import torch

from buggy_rl.effects import effect_class
from buggy_rl.proof.baselines.columns import by_chance, correlation, feature_correlations
from tests.proof.baselines import synthetic as made
from tests.proof.baselines.folder import shown

MODULE = "buggy_rl.proof.baselines.columns"


@pytest.fixture
def answer(answering):
    """Answers to columns that are known."""
    return answering(MODULE, correlation)


def test_the_column_that_is_in_it_is_named_with_its_size(answer):
    said = answer(made.synthetic([0.0, -0.4, 0.0]))
    effect = said["effects"][0]
    assert (said["verdict"], effect["name"]) == ("missing_physics", "viscous_drag")
    expected = -0.4 * effect_class("viscous_drag").declared[0].size
    rate = effect["parameters"]["rate"]
    assert rate["value"] == pytest.approx(expected, rel=0.1)
    assert rate["low"] < expected < rate["high"]
    assert effect["confidence"] > 0.9


def test_in_noise_alone_nothing_is_named_in_most_cases(answer):
    named = [
        bool(answer(made.synthetic([0.0, 0.0, 0.0], seed=seed))["effects"]) for seed in range(20)
    ]
    assert sum(named) <= 2  # one in a hundred by chance


def test_a_direction_that_an_effect_does_not_have_does_not_count(answer):
    found = made.synthetic([0.0, 0.0, -0.5])
    assert float(feature_correlations(found)[2]) == 0.0
    assert answer(found)["effects"] == []
    assert answer(made.synthetic([0.0, 0.0, 0.5]))["effects"][0]["name"] == "steering_lag"


def test_chance_is_estimated_by_shuffling_the_segments():
    found = made.synthetic([0.0, 3.0, 0.0])
    assert by_chance(found) == by_chance(found)
    assert by_chance(found) < 0.1 < float(feature_correlations(found).max())


def test_correlation_does_not_depend_on_a_columns_size():
    found = made.synthetic([0.2, 0.1, 0.3])
    larger = made.Columns(found.features, found.lacking, 7 * found.explained)
    torch.testing.assert_close(feature_correlations(found), feature_correlations(larger))


def test_drag_of_a_car_is_named(drives, tmp_path):
    effects = ["viscous_drag", "steering_gain", "throttle_lag"]
    said = correlation(shown(tmp_path, drives["draggy"], effects=effects))
    assert said["effects"][0]["name"] == "viscous_drag"
    assert said["effects"][0]["parameters"]["rate"]["value"] == pytest.approx(0.8, rel=0.2)
