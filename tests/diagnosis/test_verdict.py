from dataclasses import replace

import pytest
import torch

from buggy_rl.diagnosis.answer import NamedEffect
from buggy_rl.diagnosis.selection import Criteria
from buggy_rl.diagnosis.unexplained import Unexplained
from buggy_rl.diagnosis.verdict import verdict_of
from buggy_rl.estimation.misfit import NO_BASELINE, BaselineMisfit


def effect(name="steering_lag", kind="actuation", confidence=0.97, **alternatives):
    return NamedEffect(name, kind, "", "", {}, confidence, 0.9, alternatives)


def rest(excess=0.0, share=0.0):
    return Unexplained(excess, share, {"vx": 1.0}, [], False)


def verdict(given, left, named, usual=NO_BASELINE):
    return verdict_of(given, left, named, Criteria(torch.zeros(1), usual=usual))


GRIP = effect("parameter:grip_front", "parameter")
MISSPECIFIED = replace(effect(confidence=0.3), varies_with="vx")


@pytest.mark.parametrize(
    ("given", "left", "named", "expected"),
    [
        (0.02, rest(0.02), [], "no_mismatch"),
        (1.0, rest(1.0, 1.0), [], "unknown_physics"),
        (1.0, rest(0.0), [effect()], "missing_physics"),
        (1.0, rest(0.0), [GRIP], "wrong_parameters"),
        (1.0, rest(0.0), [GRIP, effect()], "missing_physics"),
        (1.0, rest(0.5, 0.5), [effect(confidence=0.3)], "unknown_physics"),
        # Spins that no simulator predicts do not make a sound effect doubtful.
        (1.0, rest(0.4, 0.4), [effect(confidence=0.55)], "missing_physics"),
        # Nor do two effects that share the probability.
        (1.0, rest(0.4, 0.4), [effect(confidence=0.41, steering_dead_time=0.45)], "cannot_tell"),
        (1.0, rest(0.5, 0.5), [effect(confidence=0.15, steering_dead_time=0.5)], "unknown_physics"),
        (1.0, rest(0.0), [effect(confidence=0.3)], "cannot_tell"),
        (1.0, rest(0.0), [effect(confidence=0.85, steering_dead_time=0.12)], "cannot_tell"),
        (1.0, rest(0.0), [effect(confidence=0.95, steering_dead_time=0.04)], "missing_physics"),
        # A second effect that has an alternative does not put the first in doubt.
        (1.0, rest(0.0), [effect(), effect("wind", "motion", 0.6, floor_slope=0.4)],
         "missing_physics"),
        # Misspecified effects are no answer, however little remains.
        (1.0, rest(0.0), [MISSPECIFIED], "unknown_physics"),
        (1.0, rest(0.0), [MISSPECIFIED, effect()], "missing_physics"),
    ],
)  # fmt: skip
def test_the_verdict_follows_from_what_is_named_and_what_remains(given, left, named, expected):
    assert verdict(given, left, named) == expected


def test_the_excess_of_the_baseline_is_no_mismatch():
    usual = BaselineMisfit(mean=0.2, error=0.1)
    assert verdict(0.4, rest(0.4), [], usual) == "no_mismatch"
    assert verdict(0.6, rest(0.6, 1.0), [], usual) == "unknown_physics"
