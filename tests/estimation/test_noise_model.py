import pytest
import torch

from buggy_rl.estimation.noise_model import HEAVY, NoiseModel, drawn_errors, noise_model
from tests.diagnosis.planted import problem_of

UNIT = NoiseModel(torch.eye(6, dtype=torch.float64).expand(1, 6, 6), torch.ones(6))


def test_residuals_of_a_right_simulator_are_whitened_to_unit_variance(drives):
    problem = problem_of(drives["nothing"], stride=0.7)
    assert len(problem.segments) > 30
    whitened = problem.noise.whiten(problem.simulation.residuals(problem.segments))[0]
    assert whitened.shape == (len(problem.segments), 60)
    assert float(whitened.square().mean()) == pytest.approx(1.0, abs=0.1)


def test_drawn_errors_are_as_large_as_those_of_a_right_simulator_and_not_the_sensors_alone(drives):
    problem = problem_of(drives["nothing"], stride=0.7)
    exact = problem.simulation.residuals(problem.segments)[0]
    drawn = drawn_errors(problem.simulation, problem.segments)
    assert drawn.shape == (50 * len(exact), *exact.shape[1:])
    far, expected = (
        e[..., :2].square().sum(-1).mean(1).sqrt().median().item() for e in (exact, drawn)
    )
    assert far == pytest.approx(expected, rel=0.15)
    assert expected > 2 * problem.noise.sd[:2].norm()
    torch.testing.assert_close(drawn, drawn_errors(problem.simulation, problem.segments))


def test_residuals_within_the_extra_covariance_count_for_less(drives):
    problem = problem_of(drives["late"])
    residual = problem.simulation.residuals(problem.segments)
    plain = problem.noise.whiten(residual).square().mean()
    wrong = residual.flatten(2)[0].double()
    extra = wrong.mT @ wrong / len(wrong)
    wider = noise_model(problem.simulation, problem.segments, extra=extra)
    assert plain > 3.0
    assert wider.whiten(residual).square().mean() < 1.0


def test_without_what_is_usual_on_a_baseline_the_sensor_is_left(drives):
    problem = problem_of(drives["nothing"], [])
    wrong = 0.01 * torch.randn(
        40, problem.noise.dimension, generator=torch.Generator().manual_seed(0)
    )
    extra = (wrong.mT @ wrong / len(wrong)).double()
    wider = noise_model(problem.simulation, problem.segments, extra=extra)
    torch.testing.assert_close(
        wider.of_sensor.whitening, problem.noise.whitening, rtol=1e-6, atol=1e-6
    )
    assert problem.noise.of_sensor is problem.noise


def test_the_weight_is_the_slope_of_the_loss():
    square = torch.tensor([0.0, 3.0, 60.0, 6000.0], dtype=torch.float64)
    for dispersion in (1.0, 2.5):
        rise = (UNIT.loss(square + 1e-4, dispersion) - UNIT.loss(square, dispersion)) / 1e-4
        # Twice the loss by the square, times the dispersion.
        torch.testing.assert_close(
            2 * dispersion * rise, UNIT.weight(square, dispersion), rtol=1e-4, atol=0
        )


def test_the_loss_of_noise_is_half_its_square_and_that_of_a_spin_grows_with_the_logarithm():
    # h = 4 * 6 = 24: 12 log(1 + 6 / 24) = 2.678 for a square of 6; 12 log(1001) = 82.9 for 24000.
    loss = UNIT.loss(torch.tensor([6.0, 24_000.0], dtype=torch.float64))
    assert HEAVY * UNIT.dimension == 24
    assert loss.tolist() == pytest.approx([2.678, 82.905], abs=1e-3)


def test_a_residual_that_is_not_finite_is_large():
    values = [float("nan"), float("inf"), -float("inf"), 0.0, 2e3, 1.0]
    residual = torch.tensor(values).view(1, 1, 1, 6)
    assert UNIT.whiten(residual)[0, 0].tolist() == [1e3, 1e3, -1e3, 0.0, 1e3, 1.0]
