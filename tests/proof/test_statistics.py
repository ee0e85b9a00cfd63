"""Intervals and calibration, worked by hand."""

from statistics import median

import pytest

from buggy_rl.proof.score.figures import clustered, clustered_share, middle, share, written
from buggy_rl.proof.score.score import (
    calibration,
    calibration_error,
    debiased_calibration_error,
    selective_accuracy,
)


def test_wilsons_interval_of_eight_in_ten():
    # z^2 = 3.8415; middle (0.8 + 0.19207) / 1.38415 = 0.71674; half
    # 1.95996 sqrt(0.016 + 0.0096036) / 1.38415 = 0.22658.
    figure = share([True] * 8 + [False] * 2)
    assert figure.value == 0.8
    assert (figure.low, figure.high) == pytest.approx((0.4902, 0.9433), abs=1e-4)
    assert figure.count == 10


def test_wilsons_interval_is_not_empty_where_all_is_right():
    # z^2 / (n + z^2) = 3.8415 / 23.8415 = 0.1611 is open below 1.
    figure = share([True] * 20)
    assert figure.high == pytest.approx(1.0)
    assert figure.low == pytest.approx(1 - 0.1611, abs=1e-4)
    assert share([]).count == 0


def test_a_median_has_an_interval_that_repeats():
    figure = middle([1.0, 2.0, 3.0, 4.0, 100.0])
    assert figure.value == 3.0
    assert 1.0 <= figure.low <= 3.0 <= figure.high <= 100.0
    assert figure == middle([1.0, 2.0, 3.0, 4.0, 100.0])


def test_an_interval_of_clusters_is_that_of_fewer_cases():
    # Two clusters of ten, p = 0.5: of alternating hits each sums to 0, so nothing is shared.
    apart = [[True, False] * 5, [True, False] * 5]
    assert clustered_share(apart) == share([True, False] * 10)
    # Four clusters of five, all alike within: deff = 4 / 3 * 4 * 2.5^2 / 5 = 20 / 3, t_3 = 3.18245,
    # n' = 20 / (20 / 3) * (1.95996 / 3.18245)^2 = 1.13788; Wilson's half width at p = 0.5 is
    # 1.95996 sqrt(0.25 / n' + z^2 / (4 n'^2)) / (1 + z^2 / n') = 0.43921.
    alike = [[True] * 5, [True] * 5, [False] * 5, [False] * 5]
    figure = clustered_share(alike)
    assert (figure.value, figure.count) == (0.5, 20)
    assert (figure.low, figure.high) == pytest.approx((0.06079, 0.93921), abs=2e-4)
    assert clustered_share([[True] * 5]) == share([True] * 5)
    assert clustered_share([[True], [], [True]]) == share([True, True])
    assert clustered_share([[]]).count == 0


def test_a_median_of_clusters_is_never_told_more_narrowly_than_of_single_values():
    values = [1.0, 2.0, 3.0, 10.0, 11.0, 12.0]
    alone, together = middle(values), clustered([values[:3], values[3:]], median)
    assert together.value == alone.value
    assert together.low <= min(alone.low, 2.0)  # the first cluster alone, in a quarter of resamples
    assert together.high >= max(alone.high, 11.0)
    assert clustered([], median).count == 0


def test_one_value_tells_no_interval():
    assert written(middle([0.25])) == "25.0 %"
    assert written(clustered([[0.25]], median), percent=False) == "0.250"
    assert written(share([True])) == "100.0 % (20.7 to 100.0)"


CLAIMS = [(0.95, True), (0.95, True), (0.95, False), (0.55, True), (0.55, False)]


def test_calibration_compares_what_was_said_with_what_was_right():
    assert calibration(CLAIMS) == [
        (pytest.approx(0.55), 0.5, 2),
        (pytest.approx(0.95), pytest.approx(2 / 3), 3),
    ]
    # (2 * |0.55 - 0.5| + 3 * |0.95 - 2/3|) / 5 = (0.1 + 0.85) / 5
    assert calibration_error(CLAIMS) == pytest.approx(0.19)
    assert calibration_error([(1.0, True)]) == 0.0


def test_chance_counts_as_no_error_of_calibration():
    # Right as often as said, as far as four of ten can be: (0.45 - 0.4)^2 < 0.4 * 0.6 / 9.
    assert debiased_calibration_error([(0.45, i < 4) for i in range(10)]) == 0.0
    # (0.95 - 0.5)^2 - 0.25 / 99 = 0.19997
    off = debiased_calibration_error([(0.95, i < 50) for i in range(100)])
    assert off == pytest.approx(0.19997**0.5, abs=1e-4)


def test_answering_only_the_surest_is_traded_against_being_right():
    assert selective_accuracy(CLAIMS) == [(0.6, pytest.approx(2 / 3)), (1.0, pytest.approx(0.6))]
