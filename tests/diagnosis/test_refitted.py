"""What a hypothesis leaves of a simulated manoeuvre once its numbers are fitted to it."""

from types import SimpleNamespace

import numpy as np
import torch

from buggy_rl.diagnosis.answer.experiments import refitted
from buggy_rl.diagnosis.answer.manoeuvres import HEADINGS, TIMES

DISPERSION = 2.0
GENERATOR = torch.Generator().manual_seed(0)


def drawn(*shape):
    return torch.randn(*shape, generator=GENERATOR, dtype=torch.float64)


def left(difference, jacobian, sd):
    """By least squares with rows for what is known of the numbers already."""
    truth = SimpleNamespace(whitened=torch.zeros_like(difference))
    vector = torch.zeros(jacobian.shape[-1], dtype=torch.float64)
    fit = SimpleNamespace(whitened=difference, jacobian=jacobian, vector=vector)
    covariance = torch.diag(torch.tensor(sd, dtype=torch.float64) ** 2)
    known = SimpleNamespace(cross_validated=SimpleNamespace(covariance=covariance))
    return refitted(truth, fit, known, DISPERSION)


def test_a_difference_that_its_numbers_can_make_is_fitted_away():
    jacobian = drawn(6, 8, 2)
    difference = jacobian @ torch.tensor([0.3, -0.2], dtype=torch.float64)
    assert left(difference, jacobian, (10.0, 10.0)).abs().max() < 1e-3
    torch.testing.assert_close(
        left(difference, jacobian, (1e-4, 1e-4)), difference, atol=1e-2, rtol=0
    )


def test_it_is_the_solution_of_least_squares_with_what_is_known():
    jacobian, difference, sd = drawn(6, 8, 2), drawn(6, 8), (0.2, 0.05)
    weight = (TIMES / HEADINGS / DISPERSION) ** 0.5
    rows = np.concatenate([weight * jacobian.flatten(0, 1).numpy(), np.diag(1 / np.array(sd))])
    wanted = np.concatenate([weight * difference.flatten().numpy(), np.zeros(2)])
    moved = torch.from_numpy(np.linalg.lstsq(rows, wanted, rcond=None)[0])
    torch.testing.assert_close(
        left(difference, jacobian, sd), difference - jacobian @ moved, atol=1e-6, rtol=1e-4
    )
