import pytest
import torch

from buggy_rl.estimation.evidence import CAP, NOTHING, baseline_misfit, misfit, typical


def test_a_spin_counts_as_no_more_than_the_cap():
    # (1 + 1 + 10) / 3 = 4, where the spin's own 1e3 would be all that is seen.
    square = torch.tensor([1.0, 1.0, 1e6])
    assert CAP == 100
    assert misfit(square) == 4.0
    assert typical(square) == 1.0


def test_where_most_segments_are_beyond_the_cap_the_median_counts():
    assert misfit(torch.full((5,), 900.0)) == 30.0
    assert misfit(torch.full((5,), 400.0)) == 20.0


def test_a_spin_counts_as_closed_by_as_much_as_it_is():
    given = torch.tensor([1.0, 1.0, 100.0**2])
    assert misfit(given, given) == pytest.approx(4.0)
    # Half of the way from 100 to 1: half of what the cap lets count, 1 + 9 / 2.
    assert misfit(torch.tensor([1.0, 1.0, 50.5**2]), given) == pytest.approx((1 + 1 + 5.5) / 3)
    # Worse than given, it counts as no more than before; and noise alone is noise alone.
    assert misfit(torch.tensor([1.0, 1.0, 1e6]), given) == pytest.approx(4.0)
    assert misfit(torch.ones(3), given) == pytest.approx(1.0)


def test_the_standard_error_of_the_baseline_is_the_spread_of_its_blocks():
    # Blocks with means 0.8 and 1.2: spread 0.2828, over sqrt(9).
    old = torch.tensor([0.64, 0.64, 1.44, 1.44])
    found = baseline_misfit(old, torch.tensor([0, 0, 1, 1]), 9)
    assert found.mean == pytest.approx(0.0, abs=1e-6)
    assert found.error == pytest.approx(0.2828 / 3, rel=1e-3)
    assert found.most == pytest.approx(0.2828, rel=1e-3)
    # Where all is noise, no less than what counts as none.
    assert baseline_misfit(torch.full((4,), 0.9), torch.tensor([0, 0, 1, 1]), 9).most == NOTHING
