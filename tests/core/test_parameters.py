"""The range of a parameter, to the last digit that a file holds of it."""

import pytest

from buggy_rl.core.parameters import Parameter

HIGHEST = 1.4 * 0.087  # 0.12179999999999998


def axle(value: float) -> Parameter:
    return Parameter("axle", value, 0.6 * 0.087, HIGHEST, "m", "where the front axle is")


@pytest.mark.parametrize("value", [0.0522, 0.087, 0.1218])
def test_a_bound_that_was_rounded_in_a_file_is_within_the_range(value):
    read = axle(value)
    assert read.lower <= read.value <= read.upper
    assert read.value == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize("value", [0.0521, 0.05219999, 0.12180001, 0.1219, float("nan")])
def test_what_is_beyond_it_is_refused_with_its_range(value):
    with pytest.raises(ValueError, match=r"'axle' is .* m, outside its range \[0.0522"):
        axle(value)
