from dataclasses import replace

import pytest
import torch

from buggy_rl.estimation.evidence import (
    CrossValidated,
    advantage,
    blocks,
    cross_validated,
    jackknife,
)
from buggy_rl.estimation.gauss_newton import fitted, normal_equations
from tests.diagnosis.planted import problem_of


def validated(problem, fit):
    [found] = cross_validated(problem, [fit], blocks(problem.segments))
    return found


def test_without_a_block_the_fit_moves_as_the_linear_one_says(late):
    # The exact leave-one-block-out fit is run; what it predicts of the block is compared.
    problem, (right, _) = late
    group = blocks(problem.segments)
    predicted = validated(problem, right)
    name = group.unique()[0]
    kept, out = torch.nonzero(group != name).flatten(), group == name
    start = problem.library.hypothesis(right.effects, right.vector.tolist())
    [again] = fitted(problem[kept], [start], 4)
    [whitened] = problem.whitened([(right, again.vector)])
    exact = whitened.square().sum(-1)[out].sum()
    assert float(predicted.square[out].sum()) == pytest.approx(float(exact), rel=0.02)
    assert float(exact) >= float(right.square[out].sum()) - 1.0  # held out is no better than fitted


def test_held_out_blocks_are_rolled_out_at_the_vector_fitted_without_them(late):
    # Not along the Jacobian of the vector that was fitted with the block.
    problem, (right, _) = late
    group = blocks(problem.segments)
    curvature, score = normal_equations(problem, right)
    hessian = curvature.sum(0) + torch.diag(right.prior**-2)
    found = validated(problem, right).square
    for name in group.unique():
        rows = group == name
        move = torch.linalg.solve(hessian - curvature[rows].sum(0), score[rows].sum(0))
        [whitened] = problem.whitened([(right, right.vector + move)])
        expected = whitened.square().sum(-1)[rows]
        torch.testing.assert_close(found[rows], expected, rtol=1e-4, atol=1e-4)


def test_to_first_order_what_is_held_out_is_nearly_what_a_rollout_shows_and_takes_none(late):
    problem, (right, _) = late
    group, rolled = blocks(problem.segments), []
    told = replace(problem.simulation, rolled=lambda *rollout: rolled.append(rollout))
    [linear] = cross_validated(replace(problem, simulation=told), [right], group, anew=False)
    anew = validated(problem, right)
    assert rolled == []
    torch.testing.assert_close(linear.covariance, anew.covariance)
    assert not torch.equal(linear.whitened, anew.whitened)
    moved = (anew.whitened - right.whitened).norm()
    assert float((linear.whitened - anew.whitened).norm()) < 0.3 * float(moved)


def test_the_covariance_covers_the_truth_and_is_positive_definite(late):
    problem, (right, _) = late
    covariance = validated(problem, right).covariance
    torch.testing.assert_close(covariance, covariance.mT, rtol=1e-9, atol=0)
    assert (torch.linalg.eigvalsh(covariance) > 0).all()
    parameter = right.coordinates[0].parameter
    off = abs(float(right.vector[0]) - parameter.coordinate(0.06))
    spread = float(covariance[0, 0].sqrt())
    assert off < 4 * spread
    assert spread * parameter.size < 0.005  # [s]: these recordings tell it well


def test_the_jackknife_covariance_of_a_mean_of_three_blocks_is_that_of_the_textbook():
    # r_n = y_n - z of unit noise, J = -1: H_n = 1, s_n = z - y_n at the mean z of y = 1, 4, 7.
    z, y = 4.0, torch.tensor([1.0, 4.0, 7.0], dtype=torch.float64)
    curvature = torch.ones(3, 1, 1, dtype=torch.float64)
    score = (z - y).unsqueeze(-1)
    wide = torch.tensor([1e-12], dtype=torch.float64)
    moves, covariance = jackknife(curvature, score, wide, torch.tensor([0, 1, 2]))
    # Means without a block are 5.5, 4 and 2.5: moved by 1.5, 0 and -1.5.
    assert moves.flatten().tolist() == pytest.approx([1.5, 0.0, -1.5])
    # 2/3 (1.5^2 + 1.5^2) = 3: s^2 / n with s^2 = (9 + 0 + 9) / 2.
    assert float(covariance) == pytest.approx(3.0)


def test_the_jackknife_keeps_the_prior_variance_that_the_data_leave():
    # Precision 3 of the prior beside curvature 1 of each of three blocks, no score: nothing moves,
    # and the variance is H^-1 L H^-1 = 3 / (3 + 3)^2.
    curvature = torch.ones(3, 1, 1, dtype=torch.float64)
    score = torch.zeros(3, 1, dtype=torch.float64)
    prior = torch.tensor([3.0], dtype=torch.float64)
    moves, covariance = jackknife(curvature, score, prior, torch.tensor([0, 1, 2]))
    assert not moves.any()
    assert float(covariance) == pytest.approx(3 / 36)


def test_the_advantage_is_the_sum_of_what_is_gained():
    class Half:
        def loss(self, square, dispersion):
            return 0.5 * square / dispersion

    # Gains (worse - better) / 2 by segment: 5, 3, -2, 1.
    worse = CrossValidated(torch.tensor([[12.0], [8.0], [4.0], [6.0]]).sqrt(), torch.eye(1))
    better = CrossValidated(torch.tensor([[2.0], [2.0], [8.0], [4.0]]).sqrt(), torch.eye(1))
    assert advantage(Half(), 1.0, better, worse) == pytest.approx(7.0)  # type: ignore


def test_blocks_are_8_s_of_one_recording(drives):
    # Recordings of 10 s, starts at 0, 1, ... 8 s: eight in the first block and one in the second.
    problem = problem_of(drives["nothing"])
    assert blocks(problem.segments).bincount().tolist() == [8, 1] * 3
