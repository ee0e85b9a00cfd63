"""Sparse search: effects that add up are found together, and nothing is where nothing is."""

import numpy as np
import pytest
import torch
from scipy.optimize import lsq_linear

from buggy_rl.estimation.gauss_newton import Fit, Problem
from buggy_rl.estimation.hypothesis import Library
from buggy_rl.estimation.noise_model import NoiseModel
from buggy_rl.estimation.sparse import FARTHEST, Secants, proposals

SEGMENTS, NUMBERS = 12, 60
NAMES = ("throttle_gain", "steering_gain", "payload", "viscous_drag", "gyro_bias", "sensor_yaw")
PRICE = 5.0  # [nats] of an effect more
SIZE = 1.5  # [prior scales] of every trial


def problem(dispersion=1.0):
    whitening = torch.eye(NUMBERS, dtype=torch.float64).expand(SEGMENTS, NUMBERS, NUMBERS)
    noise = NoiseModel(whitening, torch.ones(6))
    library = Library(NAMES)
    return Problem(None, None, noise, library, dispersion)  # type: ignore[arg-type]


def made(seed, mixture, size=20.0, noise=1.0):
    """A base whose residual is minus a mixture of the trials' moves, and the trials."""
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape):
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    at = problem()
    moves = size / NUMBERS**0.5 * normal(len(NAMES), SEGMENTS, NUMBERS)
    residual = noise * normal(SEGMENTS, NUMBERS)
    for name, share in mixture.items():
        residual = residual - share * moves[NAMES.index(name)]
    clock = at.library.hypothesis(())
    base = Fit((), clock.coordinates, clock.vector, residual, normal(SEGMENTS, NUMBERS, 1))
    trials = []
    for name, move in zip(NAMES, moves, strict=True):
        start = at.library.hypothesis((name,))
        vector = start.vector.clone()
        vector[0] = SIZE
        trials.append(Fit((name,), start.coordinates, vector, residual + move))
    return at, base, trials


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    "mixture",
    [
        {"payload": 0.8},
        {"payload": 0.8, "gyro_bias": 0.5},
        {"payload": 0.8, "gyro_bias": 0.5, "steering_gain": 1.2},
    ],
)
def test_effects_that_act_together_are_found_together(seed, mixture):
    at, base, trials = made(seed, mixture)
    found = proposals(Secants.of(at, base, trials), 3)
    best = min(found, key=lambda p: p.loss + PRICE * len(p.key))
    assert best.key == tuple(sorted(mixture))
    for name, share in mixture.items():
        number = at.library.numbers(name)[0].name
        assert best.start.named()[name, number] == pytest.approx(share * SIZE, rel=0.1)


def test_where_there_is_noise_only_no_set_gains_more_than_chance():
    at, base, trials = made(7, {})
    secants = Secants.of(at, base, trials)
    nothing = float(at.noise.loss(base.square).sum())
    best = min(proposals(secants, 3), key=lambda p: p.loss)
    # Twice the gain of three coefficients and a clock is chi-squared of 4: 20 is one in 2000,
    # times 20 sets of three.
    assert nothing - best.loss < 15


def test_every_set_is_proposed_once_and_its_loss_falls_with_what_is_added():
    at, base, trials = made(1, {"payload": 0.8, "gyro_bias": 0.5})
    found = proposals(Secants.of(at, base, trials), 2)
    keys = [p.key for p in found]
    assert len(set(keys)) == len(keys) == 6 + 15
    loss = {p.key: p.loss for p in found}
    for key in keys:
        for one in key if len(key) == 2 else ():
            assert loss[key] <= loss[(one,)] + 1e-6
    assert [p.loss for p in found] == sorted(loss.values())


@pytest.mark.parametrize("seed", range(3))
def test_the_coefficients_are_those_of_bounded_least_squares(seed):
    # Two of them against the truth's sign, or beyond what a trial may be stretched to.
    _, base, trials = made(seed, {"payload": -0.8, "gyro_bias": 2.5, "sensor_yaw": 0.5}, noise=0.1)
    wide = problem(dispersion=1e6)  # the loss is quadratic, and the prior counts for as much less
    secants = Secants.of(wide, base, trials)
    members = torch.tensor([[NAMES.index(n) for n in ("payload", "gyro_bias", "sensor_yaw")]])
    _, share, clock = secants.solved(members)
    columns = [(trials[i].whitened - base.whitened).flatten() for i in members[0].tolist()]
    columns.append(base.jacobian[..., 0].flatten())
    root = 1e3 * torch.stack([t.vector[0] / 3.0 for t in trials])[members[0]]
    prior = torch.diag(torch.cat([root, 1e3 / base.prior]))
    stacked = torch.cat([torch.stack(columns, -1), prior])
    target = torch.cat([-base.whitened.flatten(), torch.zeros(4, dtype=torch.float64)])
    expected = lsq_linear(
        stacked.numpy(), target.numpy(), ([0, 0, 0, -np.inf], [FARTHEST] * 3 + [np.inf])
    ).x
    np.testing.assert_allclose(torch.cat([share[0], clock[0]]).numpy(), expected, atol=1e-3)


def test_a_set_that_is_asked_for_is_proposed_however_poor(monkeypatch):
    at, base, trials = made(2, {"payload": 0.8})
    monkeypatch.setattr("buggy_rl.estimation.sparse.BEAM", 1)
    poor = ("gyro_bias", "sensor_yaw", "steering_gain")
    secants = Secants.of(at, base, trials)
    assert poor not in {p.key for p in proposals(secants, 2)}
    assert poor in {p.key for p in proposals(secants, 2, also=[poor])}


def swapped(seed):
    """A base with a wrong effect in it, what it leaves, and the rollout without that effect."""
    at, base, trials = made(seed, {"payload": 0.8, "gyro_bias": 0.5})
    wrong = next(t for t in trials if t.effects == ("sensor_yaw",))
    move = wrong.whitened - base.whitened
    start = at.library.hypothesis(("sensor_yaw",))
    vector = torch.tensor([SIZE, 0.0], dtype=torch.float64)
    jacobian = torch.cat([move.unsqueeze(-1) / SIZE, base.jacobian], -1)
    centre = Fit(("sensor_yaw",), start.coordinates, vector, wrong.whitened, jacobian)
    more = []
    for trial in trials:
        if trial.effects != ("sensor_yaw",):
            both = at.library.at(("sensor_yaw", *trial.effects), centre.named() | trial.named())
            more.append(Fit(both.effects, both.coordinates, both.vector, trial.whitened + move))
    return at, base, centre, more


@pytest.mark.parametrize("seed", range(3))
def test_a_wrong_effect_is_taken_out_and_right_ones_put_in_at_once(seed):
    at, base, centre, more = swapped(seed)
    secants = Secants.of(at, centre, more, [base])
    found = proposals(secants, 4, added=2, removed=1)
    best = min(found, key=lambda p: p.loss + PRICE * len(p.key))
    assert best.key == ("gyro_bias", "payload")
    assert best.start.named()["payload", "mass_ratio"] == pytest.approx(0.8 * SIZE, rel=0.1)
    # From the base without the wrong effect the same set has the same loss.
    alone = proposals(Secants.of(at, base, made(seed, {"payload": 0.8, "gyro_bias": 0.5})[2]), 2)
    same = next(p for p in alone if p.key == best.key)
    assert best.loss == pytest.approx(same.loss, abs=1e-6)


def test_nothing_is_taken_out_that_may_not_be():
    at, base, centre, more = swapped(0)
    found = proposals(Secants.of(at, centre, more, [base]), 3, added=2)
    assert all("sensor_yaw" in p.key for p in found)
    assert ("sensor_yaw",) not in {p.key for p in found}  # the base itself is no proposal
