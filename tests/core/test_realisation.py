"""How declared parameters follow from the numbers of an effect."""

import math

import pytest

from buggy_rl.core.parameters import Added, Scaled


@pytest.mark.parametrize(
    ("change", "number", "expected"),
    [
        (Scaled("grip", "grip"), 0.5, 0.43),  # 0.86 x 0.5
        (Scaled("loss", "speed_ratio", -1.0), 0.5, 1.72),  # 0.86 / 0.5
        (Scaled("front", "front_to_rear", 0.5), 4.0, 1.72),  # 0.86 x sqrt(4)
        (Added("dead_time", "dead_time"), 0.05, 0.91),
        (Added("viscous_friction", "rate", 2.0), 0.3, 1.46),  # 0.86 + 2 kg x 0.3 1/s
    ],
)
def test_a_parameter_follows_from_a_number_and_the_number_from_it(change, number, expected):
    assert change.changed(0.86, number) == pytest.approx(expected)
    assert change.number_at(0.86, expected) == pytest.approx(number)


def test_neutral_numbers_change_nothing_to_the_last_bit():
    assert Scaled("p", "q", 0.5).changed(0.1234567, 1.0) == 0.1234567
    assert Added("p", "q", 3.0).changed(0.1234567, 0.0) == 0.1234567


def test_a_parameter_of_zero_is_at_the_end_of_every_factor():
    assert Scaled("p", "q").number_at(2.0, 0.0) == 0.0
    assert Scaled("p", "q", -1.0).number_at(2.0, 0.0) == math.inf
    assert not Scaled("p", "q").possible(0.0)
    assert Added("p", "q").possible(0.0)
