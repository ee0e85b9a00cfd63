"""Distances of rollouts: a spin raises their mean and not their median."""

import pytest
import torch

from buggy_rl.diagnosis.repair.validation import Errors


def test_one_spin_raises_the_mean_and_not_the_median():
    instants = torch.tensor([10, 30, 100])
    square = torch.full((9, 3), 0.01**2)
    square[4] = 3.0**2
    errors = Errors()
    errors.add(square, instants, 0.01)
    assert errors.median[1.0] == pytest.approx(0.01)
    assert errors.mean_square[1.0] == pytest.approx((8 * 0.01**2 + 9) / 9)


def test_each_horizon_counts_what_lies_within_it():
    errors = Errors()
    errors.add(torch.tensor([[0.0, 0.0, 0.09]]), torch.tensor([10, 30, 100]), 0.01)
    assert errors.mean_square == {0.3: 0.0, 1.0: pytest.approx(0.03)}
    assert errors.median[1.0] == pytest.approx(0.03**0.5)


def test_horizons_that_nothing_reaches_are_left_out():
    errors = Errors()
    errors.add(torch.ones(2, 1), torch.tensor([30]), 0.01)
    errors.add(torch.ones(0, 1), torch.tensor([100]), 0.01)
    assert set(errors.median) == set(errors.mean_square) == {0.3}
