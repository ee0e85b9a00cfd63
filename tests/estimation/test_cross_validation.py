import pytest
import torch

from buggy_rl.estimation.cross_validation import Evidence, advantage, blocks, evidence
from buggy_rl.estimation.gauss_newton import Fitter
from tests.diagnosis.planted import fitter


def test_without_a_block_the_fit_moves_as_the_linear_one_says(late):
    # The exact leave-one-block-out fit is run; what it foretells of the block is compared.
    fit, (right, _) = late
    group = blocks(fit.cut)
    foretold = evidence(fit, right, group)
    name = group.unique()[0]
    kept, out = torch.nonzero(group != name).flatten(), group == name
    part = Fitter(fit.player, fit.cut[kept], fit.likelihood[kept], fit.library)
    [again] = part.fit([part.start(right.causes, right.place.tolist())], 4)
    [white] = fit.evaluate([(right, again.place)])
    exact = white.square().sum(-1)[out].sum()
    assert float(foretold.square[out].sum()) == pytest.approx(float(exact), rel=0.02)
    assert float(exact) >= float(right.square[out].sum()) - 1.0  # held out is no better than fitted


def test_what_is_held_out_is_rolled_out_where_the_fit_moves(late):
    # Each stretch at the place without its own block, not along the slopes of the place with it.
    fit, (right, _) = late
    group = blocks(fit.cut)
    curve, score = fit.normal(right)
    prior = torch.tensor([u.prior for u in right.unknowns], dtype=torch.float64)
    hessian = curve.sum(0) + torch.diag(prior**-2)
    found = evidence(fit, right, group).square
    for name in group.unique():
        rows = group == name
        move = torch.linalg.solve(hessian - curve[rows].sum(0), score[rows].sum(0))
        [white] = fit.evaluate([(right, right.place + move)])
        torch.testing.assert_close(found[rows], white.square().sum(-1)[rows], rtol=1e-4, atol=1e-4)


def test_the_covariance_covers_the_truth_and_is_one(late):
    fit, (right, _) = late
    covariance = evidence(fit, right, blocks(fit.cut)).covariance
    torch.testing.assert_close(covariance, covariance.mT, rtol=1e-9, atol=0)
    assert (torch.linalg.eigvalsh(covariance) > 0).all()
    parameter = right.unknowns[0].parameter
    off = abs(float(right.place[0]) - parameter.coordinate(0.06))
    spread = float(covariance[0, 0].sqrt())
    assert off < 4 * spread
    assert spread * parameter.size < 0.005  # [s]: these drives tell it well


def test_the_advantage_is_summed_by_blocks():
    class Half:
        def loss(self, square, temper):
            return 0.5 * square / temper

    # Gains (worse - better) / 2 by stretch: 5, 3, -2, 1; by block: 8, -2, 1.
    worse = Evidence(torch.tensor([12.0, 8.0, 4.0, 6.0]), torch.eye(1))
    better = Evidence(torch.tensor([2.0, 2.0, 8.0, 4.0]), torch.eye(1))
    found = advantage(Half(), 1.0, better, worse, torch.tensor([0, 0, 1, 2]))  # type: ignore
    assert (found.won, found.lost, found.without_best) == (9.0, 2.0, -1.0)


def test_blocks_are_8_s_of_one_drive(drives):
    # Drives of 10 s, starts at 0, 1, ... 8 s: eight in the first block and one in the second.
    fit = fitter(drives["nothing"])
    assert blocks(fit.cut).bincount().tolist() == [8, 1] * 3
