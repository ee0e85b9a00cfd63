from dataclasses import replace

import pytest

from buggy_rl.diagnosis.answer import Named
from buggy_rl.diagnosis.unexplained import Remaining
from buggy_rl.diagnosis.verdict import verdict_of
from buggy_rl.estimation.misfit import Usual


def cause(name="steering_lag", kind="actuation", sure=0.97, **rivals):
    return Named(name, kind, "", "", {}, sure, 0.9, rivals)


def rest(excess=0.0, share=0.0):
    return Remaining(excess, share, {"vx": 1.0}, [], False)


GRIP = cause("parameter:grip_front", "parameter")


LOOKALIKE = replace(cause(sure=0.3), varies_with="vx")


@pytest.mark.parametrize(
    ("given", "left", "named", "verdict"),
    [
        (0.02, rest(0.02), [], "no_mismatch"),
        (1.0, rest(1.0, 1.0), [], "unknown_physics"),
        (1.0, rest(0.0), [cause()], "missing_physics"),
        (1.0, rest(0.0), [GRIP], "wrong_parameters"),
        (1.0, rest(0.0), [GRIP, cause()], "missing_physics"),
        (1.0, rest(0.5, 0.5), [cause(sure=0.3)], "unknown_physics"),
        # Spins that nobody foretells do not take a sound name away.
        (1.0, rest(0.4, 0.4), [cause(sure=0.55)], "missing_physics"),
        # Nor do two names that share what is likely.
        (1.0, rest(0.4, 0.4), [cause(sure=0.41, steering_dead_time=0.45)], "cannot_tell"),
        (1.0, rest(0.5, 0.5), [cause(sure=0.15, steering_dead_time=0.5)], "unknown_physics"),
        (1.0, rest(0.0), [cause(sure=0.3)], "cannot_tell"),
        (1.0, rest(0.0), [cause(sure=0.85, steering_dead_time=0.12)], "cannot_tell"),
        (1.0, rest(0.0), [cause(sure=0.95, steering_dead_time=0.04)], "missing_physics"),
        # A second cause that has a rival does not put the first in doubt.
        (1.0, rest(0.0), [cause(), cause("wind", "motion", 0.6, floor_slope=0.4)],
         "missing_physics"),
        # Names that only resemble what is missing are none, however little remains.
        (1.0, rest(0.0), [LOOKALIKE], "unknown_physics"),
        (1.0, rest(0.0), [LOOKALIKE, cause()], "missing_physics"),
    ],
)  # fmt: skip
def test_verdicts(given, left, named, verdict):
    assert verdict_of(given, left, named, Usual()) == verdict


def test_what_is_usual_on_the_baseline_is_no_mismatch():
    usually = Usual(mean=0.2, error=0.1)
    assert verdict_of(0.4, rest(0.4), [], usually) == "no_mismatch"
    assert verdict_of(0.6, rest(0.6, 1.0), [], usually) == "unknown_physics"
