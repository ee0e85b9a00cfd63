import math

import pytest

from buggy_rl.policies.evaluation.tables import ORIGINAL, mean_interval, share_interval


def test_the_interval_over_seeds_is_students():
    # mean 2, sd 1, t(0.975, 2) = 4.3027: 2 +- 4.3027 / sqrt(3)
    low, high = mean_interval([1.0, 2.0, 3.0])
    assert low == pytest.approx(2 - 4.3027 / math.sqrt(3), abs=1e-4)
    assert high == pytest.approx(2 + 4.3027 / math.sqrt(3), abs=1e-4)


def test_one_seed_has_no_interval():
    assert all(math.isnan(end) for end in mean_interval([1.0]))


def test_the_share_of_failures_has_the_exact_interval():
    # none of n: 0 to 1 - 0.025^(1/n); for n = 10 that is 0.3085
    assert share_interval([False] * 10) == (0.0, pytest.approx(0.3085, abs=1e-4))
    low, high = share_interval([True] + [False] * 9)
    assert 0.002 < low < 0.003
    assert high == pytest.approx(0.445, abs=1e-3)


def test_the_originals_mean_loss_is_that_of_its_own_rows():
    # Table 7.7 of the study: simulator (7.5) less car (7.6), mean over the three paths; the
    # study's simulator figures are printed without decimals, so within one waypoint.
    for policy in ("learned", "mujoco"):
        lost = [
            float(ORIGINAL["own simulator"][path][policy])
            - float(ORIGINAL["car"][path][policy].split()[0])
            for path in ("lap", "infinity", "random")
        ]
        printed = float(ORIGINAL["lost"]["mean"][policy])
        assert sum(lost) / 3 == pytest.approx(printed, abs=1.0)
