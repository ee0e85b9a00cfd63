"""Evidence beside what simulator and car differ in anyway: against dense Gaussians, and planted."""

import pytest
import torch
from torch.distributions import MultivariateNormal

from buggy_rl.diagnosis.search.changed import CLOCK, Changed, Usual, usual, variance_of
from buggy_rl.diagnosis.search.ways import unit_changes
from buggy_rl.effects.base import EffectParameter
from buggy_rl.estimation import noise_model
from buggy_rl.estimation.evidence import blocks
from buggy_rl.estimation.gauss_newton import Fit, Problem, fitted
from buggy_rl.estimation.hypothesis import PRIOR, Coordinate
from buggy_rl.estimation.information import Information, by_block
from buggy_rl.estimation.noise_model import NoiseModel
from buggy_rl.estimation.sparse import trials
from tests.diagnosis.planted import FEW, PLANTED, problem_of

N, D, Q = 12, 6, 3  # segments, numbers of each, columns
BLOCK = torch.arange(N) // 3
WAYS = [("wind", (1.0,)), ("payload", (1.0,)), CLOCK]
NONE = Information(torch.zeros(0, Q, Q), torch.zeros(0, Q))  # what sets are proposed from
NUMBER = EffectParameter("size", 0.0, -9.0, 9.0, "-", "A number.", 1.0, 0.1)


@pytest.fixture
def gaussian(monkeypatch):
    """A loss without heavy tails: what Laplace's method finds is exact."""
    monkeypatch.setattr(noise_model, "HEAVY", 1e9)


def drawn(seed):
    return torch.randn(N, D, Q, generator=torch.Generator().manual_seed(seed)).double()


def problem(dispersion):
    eye = torch.eye(D, dtype=torch.float64).expand(N, D, D)
    noise = NoiseModel(eye, torch.ones(6))
    return Problem(None, None, noise, None, dispersion)


def fit_of(whitened, column=None):
    """A fit at nothing; of one effect with a column [N, D], or of none."""
    if column is None:
        return Fit((), (), torch.zeros(0).double(), whitened, whitened.new_zeros(N, D, 0))
    number = Coordinate("wind", NUMBER, PRIOR)
    zero = torch.zeros(1, dtype=torch.float64)
    return Fit(("wind",), (number,), zero, whitened, column.unsqueeze(-1))


def dense(columns, variance, extra=()):
    """Covariance [N D, N D] of M (b + u_g) + n, and of what is given as (column, variance)."""
    flat = columns.reshape(N * D, Q)
    same = (BLOCK[:, None] == BLOCK[None]).repeat_interleave(D, 0).repeat_interleave(D, 1)
    covariance = torch.eye(N * D).double() + flat @ flat.T
    covariance = covariance + same * (flat @ torch.diag(variance) @ flat.T)
    for column, size in extra:
        own = column.reshape(-1)
        covariance = covariance + size * torch.outer(own, own)
    return covariance


def test_the_evidence_is_that_of_baseline_and_recordings_as_one_gaussian(gaussian):
    variance = torch.tensor([0.3, 0.05, 1e-6]).double()
    before, after = drawn(1), drawn(2)
    chance = torch.Generator().manual_seed(3)
    seen = [torch.randn(N, D, generator=chance).double() * 2 for _ in range(2)]

    ones = torch.ones(N).double()
    of_blocks = by_block(before, seen[0], ones, BLOCK)
    factor, _ = of_blocks.factor(0, 1 / variance)
    common = of_blocks.without(0, factor).total()
    common.hessian.diagonal().add_(1.0)
    since = Changed(problem(1.0), BLOCK, WAYS, after, variance, common, NONE)
    column = drawn(4)[..., 0]
    found = [since._of(f)[0] for f in (fit_of(seen[1]), fit_of(seen[1], column))]

    # b is shared by both, so that they covary.
    shared = before.reshape(N * D, Q) @ after.reshape(N * D, Q).T
    both = torch.cat([part.reshape(-1) for part in seen])
    densities = []
    for extra in ((), ((column, PRIOR**2),)):
        parts = dense(before, variance), dense(after, variance, extra)
        covariance = torch.cat(
            [torch.cat([parts[0], shared], 1), torch.cat([shared.T, parts[1]], 1)]
        )
        densities.append(
            float(MultivariateNormal(torch.zeros(2 * N * D).double(), covariance).log_prob(both))
        )
    assert found[1] - found[0] == pytest.approx(densities[1] - densities[0], abs=1e-6)


def test_what_differs_from_block_to_block_is_no_evidence(gaussian):
    columns, chance = drawn(1), torch.Generator().manual_seed(0)
    noise = torch.randn(N, D, generator=chance).double()
    common = Information(torch.eye(Q).double() / 0.01, torch.zeros(Q).double())
    sizes = torch.tensor([2.0, -2.0, 2.0, -2.0]).double()[BLOCK]  # by block, about nothing
    same = 2.0 * torch.ones(N).double()
    gained = {}
    for name, size in (("differs", sizes), ("shared", same)):
        seen = noise - columns[..., 0] * size[:, None]
        tau2 = variance_of([by_block(columns, seen, torch.ones(N).double(), BLOCK)])
        since = Changed(problem(1.0), BLOCK, WAYS, columns, tau2, common, NONE)
        null, own = (since._of(f)[0] for f in (fit_of(seen), fit_of(seen, columns[..., 0])))
        gained[name] = own - null
    assert gained["differs"] < 0
    assert gained["shared"] > 3


def test_the_best_set_is_at_none_and_a_worse_fit_raises_the_dispersion_for_all(gaussian):
    columns = drawn(1)
    common = Information(torch.eye(Q).double(), torch.zeros(Q).double())
    tau2 = torch.full((Q,), 1e-6).double()
    since = Changed(problem(1.0), BLOCK, WAYS, columns, tau2, common, NONE)
    far = 5 * torch.randn(N, D, generator=torch.Generator().manual_seed(5)).double()
    found = since.log_evidence([fit_of(far), fit_of(2 * far)])
    assert found[0] == 0.0
    alone = [since._of(f)[0] for f in (fit_of(far), fit_of(2 * far))]
    assert 0 < -found[1] < alone[0] - alone[1]


def blocks_of(numbers, information=100.0):
    """Blocks of which each number [G, Q] is measured alone, and as surely."""
    hessian = information * torch.eye(numbers.shape[1]).double().expand(len(numbers), -1, -1)
    return Information(hessian, -information * numbers)


def test_the_variance_is_that_from_block_to_block_about_the_mean_of_each_group():
    chance = torch.Generator().manual_seed(0)
    spread = torch.tensor([0.5, 0.0]).double()
    groups = [
        blocks_of(mean + (spread**2 + 0.01).sqrt() * torch.randn(60, 2, generator=chance).double())
        for mean in (0.8, -0.4)
    ]
    wide, none = variance_of(groups).sqrt().tolist()
    assert wide == pytest.approx(0.5, rel=0.15)
    assert none < 0.06


def test_of_numbers_that_do_the_same_together_deviate_as_much_as_one():
    chance = torch.Generator().manual_seed(1)
    size = 0.5 * torch.randn(80, 1, 1, generator=chance).double()
    one = 100.0 * torch.ones(80, 2, 2).double()  # x_0 + x_1 is measured
    both = Information(one, (-100.0 * size.squeeze(-1)).expand(80, 2))
    tau2 = variance_of([both])
    assert float(tau2.sum()) == pytest.approx(0.25, rel=0.3)


def test_without_a_baseline_little_of_every_effect_is_expected_anyway():
    known = Usual(WAYS, None, 1.0).common([0, 2], torch.full((2,), 0.3).double())
    assert known.hessian.diagonal().tolist() == pytest.approx([100.0, 100.0])
    assert known.score.tolist() == [0.0, 0.0]


def test_a_baseline_tells_the_common_numbers_as_surely_as_its_blocks_agree():
    of_blocks = blocks_of(torch.full((9, 3), 0.7).double())
    variance = torch.tensor([1e-6, 0.09, 1.0]).double()
    known = Usual(WAYS, of_blocks, 1.0).common([0, 1, 2], variance)
    expected = 1 + 9 / (variance + 0.01)
    torch.testing.assert_close(known.hessian.diagonal(), expected)
    told = -torch.linalg.solve(known.hessian, known.score)
    torch.testing.assert_close(told, 0.7 * (expected - 1) / expected)


def since(recordings, baseline=None):
    """What has changed in recordings, fits of the planted effect alone and of nothing, trials."""
    problem = problem_of(recordings, FEW)
    known = None if baseline is None else usual(problem_of(baseline, FEW))
    null, late = problem.library.hypothesis(()), problem.library.hypothesis(("steering_dead_time",))
    null, late = fitted(problem, [null, late], 10)
    rolled = problem.rolled_out(trials(problem, null))
    group, changes = blocks(problem.segments), unit_changes(null, rolled)
    found = Changed.since(known, problem, group, null, changes)
    return found, null, late, rolled


def test_what_the_baseline_shows_too_has_not_changed(drives):
    gained = {}
    for name, baseline in (("alone", None), ("changed", "nothing"), ("as before", "late")):
        found, null, late, _ = since(drives["late"], baseline and drives[baseline])
        nothing, own = found.log_evidence([null, late])
        gained[name] = own - nothing
    assert gained["changed"] > 20
    assert gained["alone"] > 20
    assert gained["as before"] < 2


@pytest.mark.parametrize(
    ("name", "planted"),
    [
        ("late", ("steering_dead_time",)),
        ("draggy", ("viscous_drag",)),
        ("two", ("steering_gain", "viscous_drag")),
    ],
)
def test_what_was_planted_is_proposed_first_of_its_size_near_its_numbers(drives, name, planted):
    found, null, _, rolled = since(drives[name], drives["nothing"])
    starts = found.proposed(null, rolled, {1: 3, 2: 2})
    sizes = [len(start.effects) for start in starts]
    assert sizes == [1, 1, 1, 2, 2]
    first = starts[sizes.index(len(planted))]
    assert tuple(sorted(first.effects)) == planted
    for effect, numbers in PLANTED[name].items():
        for number, value in numbers.items():
            assert first.values()[effect][number] == pytest.approx(value, rel=0.5)
