import pytest

from buggy_rl.blind_test.case import Case
from buggy_rl.blind_test.outcome import Outcome, Said
from buggy_rl.blind_test.reasons import reason
from buggy_rl.blind_test.score import passed

LATE = {"steering_dead_time": {"dead_time": 0.05}}
TWO = {**LATE, "wind": {"force_x": 0.2, "force_y": -0.3}}
OUTSIDE = {"sticky_servo": {"band": 0.1}}
late, lag, drag = (
    Said(name, 0.9, rivals=rivals)
    for name, rivals in (
        ("steering_dead_time", ()),
        ("steering_lag", ("steering_dead_time",)),
        ("viscous_drag", ()),
    )
)


def answered(concealed, *said, verdict="missing_physics", **options):
    case = Case(1, "reference", "reference", concealed=concealed)
    return Outcome(case, verdict=verdict, said=said, **options)


@pytest.mark.parametrize(
    ("outcome", "why"),
    [
        (answered(LATE, status="timed out"), "no answer"),
        (answered({}, drag), "a name for nothing"),
        (answered({}, verdict="unknown_physics"), "nothing is there, and it is not known what"),
        (answered(OUTSIDE, verdict="no_mismatch"), "not seen"),
        (answered(OUTSIDE, drag), "taken for what the library has"),
        (answered(OUTSIDE, Said("wind", 0.4)), "named, though not surely"),
        (answered(LATE, verdict="no_mismatch"), "not seen"),
        (answered(LATE, verdict="unknown_physics"), "no name earned its place"),
        (answered(LATE, late, verdict="unknown_physics"), "called unknown"),
        (answered(LATE, lag), "steering_dead_time stands as a rival; steering_lag is not there"),
        (answered(LATE, drag, late), "viscous_drag is not there"),
        (
            answered(LATE, drag, margin=3.0),
            "another cause does as well on these drives; steering_dead_time is not named; "
            "viscous_drag is not there",
        ),
        (
            answered(TWO, late, margin=3.0),
            "one of them hardly shows in these drives; wind is not named",
        ),
    ],
)
def test_why_an_answer_failed(outcome, why):
    assert not passed(outcome)
    assert reason(outcome) == why
