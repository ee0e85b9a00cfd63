"""The verdict is what is most probable."""

from dataclasses import replace

import pytest

from buggy_rl.diagnosis.answer.named_effect import NamedEffect
from buggy_rl.diagnosis.answer.statement import verdict_of
from buggy_rl.diagnosis.search.posterior import Posterior


def effect(name="steering_lag", kind="actuation", confidence=0.97):
    return NamedEffect(name, kind, "", "", {}, confidence, 0.9, {})


LAG, GRIP = effect(), effect("parameter:grip_front", "parameter")


@pytest.mark.parametrize(
    ("nothing", "unknown", "named", "expected"),
    [
        (0.9, 0.05, [], "no_mismatch"),
        (0.1, 0.8, [], "unknown_physics"),
        # What is less probable than unknown physics is listed, and no answer.
        (0.1, 0.6, [effect(confidence=0.3)], "unknown_physics"),
        (0.0, 0.02, [LAG], "missing_physics"),
        (0.0, 0.02, [GRIP], "wrong_parameters"),
        (0.0, 0.02, [LAG, GRIP], "missing_physics"),
        # Sets of effects are the most probable together, and none of their names is.
        (0.2, 0.2, [effect(confidence=0.4)], "cannot_tell"),
        (0.2, 0.2, [effect(confidence=0.55)], "missing_physics"),
        (0.2, 0.2, [], "cannot_tell"),
    ],
)
def test_the_verdict_is_what_is_most_probable(nothing, unknown, named, expected):
    posterior = Posterior({(): nothing, ("steering_lag",): 1 - nothing - unknown}, unknown)
    assert verdict_of(posterior, named) == expected


def test_what_the_simulator_realises_is_a_wrong_parameter_only_where_that_is_asked():
    posterior = Posterior({("tire_grip",): 0.95}, 0.02)
    grip = replace(effect("tire_grip", "motion"), inside=("grip",))
    assert verdict_of(posterior, [grip]) == "missing_physics"
    assert verdict_of(posterior, [grip], own=True) == "wrong_parameters"
