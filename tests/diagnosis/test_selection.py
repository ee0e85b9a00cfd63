import pytest

from buggy_rl.diagnosis.selection import Merit
from buggy_rl.estimation.misfit import Usual


@pytest.mark.parametrize(
    ("gap", "usual", "likeness", "least"),
    [
        (4.0, Usual(), 0.0, 0.2),  # one part in twenty of the gap
        (4.0, Usual(), 1.0, 0.6),  # three, of what does just what another cause does
        (0.1, Usual(), 0.0, 0.01),  # and never less than what matters
        (1.0, Usual(mean=0.1, error=0.2), 0.0, 0.2),  # nor than what drives differ by themselves
        # As right as on its baseline: half of the gap, or a quarter that is more than anything
        # ever closes where nothing is wrong.
        (0.2, Usual(mean=0.5), 0.0, 0.1),
        (0.4, Usual(mean=0.5), 0.0, 0.15),
        (2.0, Usual(mean=3.0), 0.0, 0.5),
        (0.6, Usual(mean=0.5), 0.0, 0.03),  # more than that: something has changed
    ],
)
def test_how_much_a_cause_must_close(gap, usual, likeness, least):
    merit = Merit(None, None, usual)
    assert merit.least(gap, likeness) == pytest.approx(least)


@pytest.mark.parametrize(
    ("large", "least"),
    [
        (0.1, 0.2),  # small for its kind: one part in twenty
        (0.5, 0.2),
        (1.0, 0.05),  # of typical size: a quarter of that
        (9.0, 0.02),  # never less than a tenth of it
    ],
)
def test_what_is_as_large_as_faults_of_its_kind_are_must_close_less(large, least):
    assert Merit(None, None, Usual()).least(4.0, 0.0, large) == pytest.approx(least)
    # However large, it must close more where it does what another cause does.
    assert Merit(None, None, Usual()).least(4.0, 1.0, large) == pytest.approx(0.4 + least)
