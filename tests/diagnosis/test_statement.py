import pytest

from buggy_rl.diagnosis.answer.named_effect import interval
from buggy_rl.diagnosis.search.posterior import NORMAL
from buggy_rl.effects.base import EffectParameter

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
