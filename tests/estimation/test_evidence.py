"""Evidence: the integral is the Gaussian's own; spread, variation and noise are told apart."""

import pytest
import torch
from torch.distributions import MultivariateNormal

from buggy_rl.estimation import evidence as module
from buggy_rl.estimation.evidence import evidence
from buggy_rl.estimation.gauss_newton import Fit
from buggy_rl.estimation.hypothesis import Library

SEGMENTS, NUMBERS, OTHERS = 40, 12, 8


def fit(seed, spread=0.0, variation=0.0, noise=1.0, gain=-1.0):
    """A fit of one effect whose residual is noise, other effects and a change with a condition."""
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape):
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    start = Library(["throttle_gain"]).hypothesis(("throttle_gain",), [gain, 0.0])
    jacobian = 3 * normal(SEGMENTS, NUMBERS, 2)
    others, conditions = 10 * normal(SEGMENTS, NUMBERS, OTHERS), normal(SEGMENTS, 2)
    changing = variation * gain * jacobian[..., 0] * conditions[:, :1]
    residual = noise * normal(SEGMENTS, NUMBERS) + others @ (spread * normal(OTHERS)) + changing
    made = Fit(start.effects, start.coordinates, start.vector, residual, jacobian)
    return made, others, conditions


def test_the_integral_is_the_density_of_the_gaussian_that_is_left(monkeypatch):
    made, others, conditions = fit(0)
    monkeypatch.setattr(module, "INDEPENDENT", 1.0)
    monkeypatch.setattr(module, "HEAVY", 1e12)  # all segments count in full
    monkeypatch.setattr(module, "SPREADS", (0.0, 0.1))
    monkeypatch.setattr(module, "VARIATIONS", (0.0, 0.2))
    monkeypatch.setattr(module, "DISPERSIONS", torch.tensor([2.0], dtype=torch.float64))
    found = evidence(made, others, conditions)
    own = made.jacobian
    varying = (own[..., :1] * made.vector[0]) * conditions[:, None, :]
    columns = torch.cat([own, others, varying], -1).flatten(0, 1)
    mean = torch.zeros(columns.shape[1], dtype=torch.float64)
    mean[:2] = made.vector  # r = -J d + ..., d ~ N(-z, .)
    best = -torch.inf
    for spread in (0.0, 0.1):
        for variation in (0.0, 0.2):
            sd = torch.cat([made.prior, torch.full((OTHERS,), spread), torch.full((2,), variation)])
            covariance = (columns * sd.double().square()) @ columns.mT
            covariance += 2.0 * torch.eye(len(columns), dtype=torch.float64)
            density = MultivariateNormal(columns @ mean, covariance)
            value = float(density.log_prob(made.whitened.flatten()))
            # Without the constant of the Gaussian, which is the same for all hypotheses.
            value += 0.5 * len(columns) * float(torch.log(torch.tensor(2 * torch.pi)))
            best = max(best, value)
    assert found.log_evidence == pytest.approx(best, rel=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_noise_alone_is_given_neither_spread_nor_variation(seed):
    found = evidence(*fit(seed))
    assert found.spread <= 0.02
    assert found.variation <= 0.05
    assert found.dispersion < 1.3
    assert found.log_evidence - found.plain < 2


@pytest.mark.parametrize("seed", range(5))
def test_a_little_of_all_other_effects_is_spread(seed):
    found = evidence(*fit(seed, spread=0.2))
    assert 0.07 <= found.spread <= 0.35
    assert found.by_spread > 10 * max(1.0, found.by_variation)
    assert found.dispersion < 1.5


@pytest.mark.parametrize("seed", range(5))
def test_an_effect_that_changes_with_a_condition_is_variation(seed):
    found = evidence(*fit(seed, variation=0.3))
    assert 0.1 <= found.variation <= 0.4
    assert found.by_variation > 5 * max(1.0, found.by_spread)


@pytest.mark.parametrize("seed", range(5))
def test_what_nothing_explains_is_dispersion(seed):
    found = evidence(*fit(seed, noise=4.0))
    assert 10 < found.dispersion < 25
    assert found.spread <= 0.12


@pytest.mark.parametrize("seed", range(5))
def test_a_number_beyond_its_prior_is_paid_for(seed):
    near, far = (evidence(*fit(seed, gain=gain)) for gain in (-1.0, -9.0))
    # (81 - 1) / (2 3^2) nats by the prior, whatever the data.
    assert near.log_evidence - far.log_evidence == pytest.approx(80 / 18, abs=1.5)


def test_a_segment_in_a_spin_does_not_decide():
    made, others, conditions = fit(3)
    spun = made.whitened.clone()
    spun[0] = 1e3
    wild = Fit(made.effects, made.coordinates, made.vector, spun, made.jacobian)
    found = evidence(wild, others, conditions)
    assert found.spread <= 0.04
    assert found.dispersion < 20
