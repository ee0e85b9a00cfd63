import pytest

from buggy_rl.diagnosis.answer import NORMAL
from buggy_rl.diagnosis.statement import decided_at_bound, interval
from buggy_rl.effects.base import EffectParameter
from buggy_rl.estimation.hypothesis import Library

GAIN = EffectParameter("gain", 1.0, 0.5, 1.5, "-", "a factor", size=0.2, probe=0.1)
RATE = EffectParameter(
    "rate", 100.0, 0.5, 100.0, "1/s", "a limit", size=4.0, probe=-50.0, reciprocal=True
)


def test_an_interval_is_two_standard_deviations_wide():
    assert interval(GAIN, 0.5, 0.1) == pytest.approx((1.1 - NORMAL * 0.02, 1.1 + NORMAL * 0.02))


def test_it_ends_where_the_parameter_does():
    assert interval(GAIN, 0.5, 100.0) == pytest.approx((0.5, 1.5))


def test_a_rate_that_may_be_no_limit_at_all_has_no_upper_bound():
    low, high = interval(RATE, 0.2, 1.0)
    # 4 / (0.2 + NORMAL + 4 / 100)
    assert (low, high) == pytest.approx((4.0 / (0.24 + NORMAL), 100.0))
    assert low < RATE.value_at(0.2) < high


def test_an_effect_is_at_its_bound_where_all_that_decides_its_size_is():
    library = Library(("grip_patch", "steering_gain", "wind"))
    at = library.hypothesis(library.effects)  # x, y, radius, grip; gain; force_x, force_y
    patch, gain, wind = ([c.effect for c in at.coordinates].index(e) for e in library.effects)
    vector = at.vector.clone()
    vector[gain], vector[wind] = 0.5, 0.5
    assert decided_at_bound(at.at(vector), library) == set()
    vector[gain], vector[wind] = 99.0, 99.0  # both force components decide the wind
    vector[patch + 3] = -99.0
    assert decided_at_bound(at.at(vector), library) == {"grip_patch", "steering_gain"}
    vector[wind + 1] = -99.0
    assert decided_at_bound(at.at(vector), library) == {"grip_patch", "steering_gain", "wind"}
