"""Numbers that real cars do not have are said; so are intervals without a meaning."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from buggy_rl.core.vehicle import Similarity
from buggy_rl.diagnosis.answer.named_effect import (
    NamedEffect,
    Value,
    check_clock,
    check_latency,
    effect_implausible,
    latencies_refused,
    undetermined,
    unusual,
)
from buggy_rl.effects import effect_class
from buggy_rl.effects.base import EffectParameter
from buggy_rl.estimation.hypothesis import Library, scaled_prior
from buggy_rl.proof.cases.sizes import COMMANDED_SIZES, SIZES

RATIO = EffectParameter("ratio", 1.0, 0.2, 5.0, "-", "Left lock over right.", 0.2, 0.1)
DRIVEN = SimpleNamespace(pose=torch.tensor([[[0.0, 0.0, 0.0], [4.0, 3.0, 0.0]]]))


@pytest.mark.parametrize("name", SIZES | COMMANDED_SIZES)
def test_sizes_that_probabilities_are_calibrated_to_are_not_implausible(name):
    declared = effect_class(name).declared
    for end in (0, 1):
        values = {p.name: p.value for p in declared}
        values |= {n: of[end] for n, of in (SIZES | COMMANDED_SIZES)[name].items()}
        assert not effect_implausible(declared, values)


def test_a_number_four_times_as_far_as_usual_is_implausible():
    usual = replace(RATIO, usual=(0.8, 1.25))
    assert not effect_implausible([usual], {"ratio": 1.9})
    assert effect_implausible([usual], {"ratio": 2.1})
    assert effect_implausible([usual], {"ratio": 0.1})
    assert not effect_implausible([RATIO], {"ratio": 4.9})


def test_a_number_beyond_what_cars_have_is_unusual_and_without_an_interval_none_is():
    usual = replace(RATIO, usual=(0.75, 1.3))
    assert unusual([usual], {"ratio": 1.79}) == ("ratio",)
    assert unusual([usual], {"ratio": 1.2}) == ()
    assert unusual([RATIO], {"ratio": 4.9}) == ()


def test_what_is_usual_scales_with_the_car():
    arm = EffectParameter("x", 0.0, -5.0, 5.0, "m", "Ahead.", 0.05, 0.01, usual=(-0.1, 0.2))
    assert scaled_prior(arm, Similarity(length=10.0)).usual == pytest.approx((-1.0, 2.0))
    assert scaled_prior(arm, Similarity(mass=2.0)).usual == (-0.1, 0.2)


def patch(x, radius):
    every = {"x": x, "y": (0.9, 1.1), "radius": radius, "grip": (0.3, 0.5)}
    return {name: Value(sum(v) / 2, *v, "") for name, v in every.items()}


@pytest.mark.parametrize(
    ("x", "radius", "expected"),
    [
        ((-4.9, 6.1), (0.05, 9.7), ("x", "radius")),  # as on tape; the room is 4 x 3 m
        ((0.5, 1.5), (0.4, 0.6), ()),
        ((0.0, 4.5), (0.4, 4.9), ("x",)),
    ],
)
def test_a_place_is_determined_within_what_was_driven(x, radius, expected):
    numbers = Library(["grip_patch"]).numbers("grip_patch")
    assert undetermined(numbers, patch(x, radius), DRIVEN) == expected


def test_an_interval_of_the_whole_range_determines_nothing():
    assert undetermined([RATIO], {"ratio": Value(1.0, 0.2, 5.0, "-")}, DRIVEN) == ("ratio",)
    assert undetermined([RATIO], {"ratio": Value(1.0, 0.5, 2.0, "-")}, DRIVEN) == ()


def test_both_are_said_with_the_effect():
    effect = NamedEffect(
        "steering_asymmetry", "actuation", "", "left turns more", {}, 0.5, 0.3,
        unusual=("left_to_right",), undetermined=("x",),
    )  # fmt: skip
    line = effect.line()
    assert "unusually large (left_to_right)" in line
    assert "not determined: x" in line
    assert effect.to_dict()["unusual"] == ["left_to_right"]


def test_no_latency_is_named_beside_a_clock_beyond_three_standard_deviations():
    assert latencies_refused(-0.014) == ()
    assert latencies_refused(-0.1) == ("sensor_latency",)
    [asked] = check_latency(["sensor_latency"], -0.1)
    assert "none is named" in asked
    [only] = check_latency(["sensor_latency"], -0.01)
    assert "the same to these drives" in only
    [clock] = check_clock(-0.1)
    assert "add -0.100 s to command_offset" in clock
