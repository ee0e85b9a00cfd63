import pytest

from buggy_rl.diagnosis.confidence import EVEN, soundness


def test_a_name_that_leaves_nothing_is_sound():
    assert soundness(0.9, 0.0) == 1.0


def test_a_name_is_as_likely_right_as_not_where_it_closes_little_more_than_it_leaves():
    assert soundness(EVEN * 0.4, 0.4) == pytest.approx(0.5)
    # r = 2 EVEN: 4 / (4 + 1).
    assert soundness(2 * EVEN * 0.3, 0.3) == pytest.approx(0.8)


def test_a_name_that_closes_nothing_is_not_sound():
    assert soundness(0.0, 0.5) == 0.0
    assert soundness(0.0, 0.0) == 0.0
