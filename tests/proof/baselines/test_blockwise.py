"""Means over blocks of recordings."""

import pytest
import torch

from buggy_rl.estimation.evidence import mean_of_blocks
from buggy_rl.estimation.noise_model import NoiseModel
from buggy_rl.proof.baselines.columns import roots


def test_a_mean_is_judged_block_by_block():
    values, group = torch.tensor([1.0, 3.0, 4.0, 6.0]), torch.tensor([0, 0, 1, 1])
    # Means 2 and 5: 3.5, standard deviation 2.12, over sqrt(2).
    assert mean_of_blocks(values, group) == pytest.approx((3.5, 1.5))


def test_of_a_single_block_nothing_is_certain():
    assert mean_of_blocks(torch.ones(3), torch.zeros(3)) == (1.0, float("inf"))


def test_a_residual_of_one_standard_deviation_is_1_and_a_huge_one_is_capped_at_10():
    noise = 0.1
    noise_model = NoiseModel(
        torch.eye(12, dtype=torch.float64).expand(1, 12, 12) / noise, torch.ones(6)
    )
    residual = torch.stack([torch.full((1, 2, 6), size) for size in (0.1, 0.3, 100.0)])
    torch.testing.assert_close(
        roots(noise_model, residual)[:, 0], torch.tensor([1.0, 3.0, 10.0], dtype=torch.float64)
    )
