import pytest
import torch

from buggy_rl.estimation.noise_model import HEAVY, Likelihood
from tests.diagnosis.planted import fitter


def test_gaps_of_a_right_simulator_are_whitened_to_noise(drives):
    fit = fitter(drives["nothing"], stride=0.7)
    assert len(fit.cut) > 30
    white = fit.likelihood.white(fit.player.play(fit.cut, {}))[0]
    assert white.shape == (len(fit.cut), 60)
    assert float(white.square().mean()) == pytest.approx(1.0, abs=0.1)


def test_what_the_simulator_is_known_to_get_wrong_counts_for_less(drives):
    from buggy_rl.estimation.noise_model import likelihood

    fit = fitter(drives["late"])
    gap = fit.player.play(fit.cut, {})
    plain = fit.likelihood.white(gap).square().mean()
    wrong = gap.flatten(2)[0].double()
    extra = wrong.mT @ wrong / len(wrong)
    told = likelihood(fit.player, fit.cut, extra=extra).white(gap).square().mean()
    assert plain > 3.0
    assert told < 1.0


def test_the_weight_is_the_slope_of_the_loss():
    unit = Likelihood(torch.eye(6, dtype=torch.float64).expand(1, 6, 6), torch.ones(6))
    square = torch.tensor([0.0, 3.0, 60.0, 6000.0], dtype=torch.float64)
    for temper in (1.0, 2.5):
        rise = (unit.loss(square + 1e-4, temper) - unit.loss(square, temper)) / 1e-4
        # twice the loss by the square, times the temper
        torch.testing.assert_close(
            2 * temper * rise, unit.weight(square, temper), rtol=1e-4, atol=0
        )


def test_a_stretch_as_good_as_noise_counts_as_half_its_square_and_a_spin_for_little():
    unit = Likelihood(torch.eye(6, dtype=torch.float64).expand(1, 6, 6), torch.ones(6))
    # h = 4 * 6 = 24: 12 log(1 + 6 / 24) = 2.678 for a square of 6; 12 log(1001) = 82.9 for 24000.
    loss = unit.loss(torch.tensor([6.0, 24_000.0], dtype=torch.float64))
    assert HEAVY * unit.readings == 24
    assert loss.tolist() == pytest.approx([2.678, 82.905], abs=1e-3)


def test_what_is_no_number_is_very_wrong_and_not_nothing():
    unit = Likelihood(torch.eye(6, dtype=torch.float64).expand(1, 6, 6), torch.ones(6))
    gap = torch.tensor([float("nan"), float("inf"), -float("inf"), 0.0, 2e3, 1.0]).view(1, 1, 1, 6)
    assert unit.white(gap)[0, 0].tolist() == [1e3, 1e3, -1e3, 0.0, 1e3, 1.0]
