import pytest
import torch

from buggy_rl.effects import make_effect
from buggy_rl.engines import make_engine
from buggy_rl.estimation.baseline import (
    SHRUNK,
    best_shrinkage,
    correct,
    lacking_acceleration,
    sensed_covariance,
    standing_misfit,
    trained,
)
from buggy_rl.estimation.misfit import misfit
from buggy_rl.estimation.noise_model import likelihood
from buggy_rl.estimation.rollout import Player
from buggy_rl.estimation.segments import stretches
from buggy_rl.policies.controllers.recording import driven
from buggy_rl.policies.controllers.room import RoomDriver
from buggy_rl.recordings import Recording
from buggy_rl.recordings.camera import Camera, CameraConfig
from tests.effects.faults import batched, over

RATE = 0.8  # [1/s] viscous drag of the wrong car, unknown to the simulator
SECONDS = 25.0


def simulator(cars):
    return make_engine("single_track", cars)


@pytest.fixture(scope="module")
def drives():
    """Stretches of three drives as a camera sees them: of a right car, and two of a wrong one."""
    car = over(
        [batched("viscous_drag", [{"rate": r} for r in (0.0, RATE, RATE)])], "single_track", 3
    )
    rows = list(driven(car, RoomDriver(seed=0), round(SECONDS / 0.01)))
    seen = [Camera(CameraConfig(), i).recorded(true) for i, true in enumerate(torch.stack(rows, 1))]
    return [stretches([Recording("drive", data, 0.01)], 0.5, 0.5) for data in seen]


@pytest.fixture(scope="module")
def right(drives):
    return drives[0]


@pytest.fixture(scope="module")
def wrong(drives):
    return drives[1]


@pytest.fixture(scope="module")
def another(drives):
    return drives[2]


def test_what_the_sensor_alone_explains_leaves_nothing_standing(right):
    sensed = sensed_covariance(Player(simulator), right)
    torch.manual_seed(0)
    noise = torch.randn(20_000, len(sensed), dtype=torch.float64)
    gap = (noise @ torch.linalg.cholesky(sensed).mT).unflatten(1, (-1, 6))
    # The largest eigenvalue of a sample of n is (1 + sqrt(D / n))^2 = 1.08 for D = 30, n = 20 000.
    over_sensed = torch.linalg.solve(sensed, standing_misfit(gap, sensed, 0.2))
    assert float(torch.linalg.eigvals(over_sensed).real.max()) < 0.1


def test_a_standing_error_is_found_at_its_size():
    # e = s u with s ~ N(0, 9) along one direction u of D = 12 with unit noise: C = 9 u u^T, of
    # which the shrinking to the diagonal keeps 80 % of what is off it.
    torch.manual_seed(0)
    u = torch.full((12,), 12**-0.5, dtype=torch.float64)
    gap = torch.randn(20_000, 12, dtype=torch.float64)
    gap += 3 * torch.randn(20_000, 1, dtype=torch.float64) * u
    got = standing_misfit(gap.unflatten(1, (2, 6)), torch.eye(12, dtype=torch.float64), 0.2)
    # Along u: 0.8 (1 + 9) + 0.2 (1 + 9 / 12) - 1 = 7.35; across nothing but 0.2 * 0.75 = 0.15.
    assert float(u @ got @ u) == pytest.approx(7.35, rel=0.05)
    across = torch.eye(12, dtype=torch.float64) - torch.outer(u, u)
    assert float((across @ got @ across).diagonal().sum()) / 11 == pytest.approx(0.15, abs=0.05)


def test_one_spin_among_many_stretches_counts_as_no_more_than_its_cap():
    torch.manual_seed(0)
    gap = torch.randn(1000, 1, 6)
    gap[0] = 900.0
    got = standing_misfit(gap, torch.eye(6, dtype=torch.float64), 0.2)
    # It adds 25 * 6 / 1000 = 0.15 to the trace, not 6 * 900^2 / 1000 = 4860.
    assert float(got.diagonal().sum()) < 0.5


def test_what_goes_together_is_believed_of_many_stretches_and_not_of_a_few():
    generator = torch.Generator().manual_seed(0)
    common, own = (torch.randn(900, n, generator=generator, dtype=torch.float64) for n in (1, 12))
    sensed, fold = torch.eye(12, dtype=torch.float64), torch.arange(900) % 3
    together = (2 * common + own).unflatten(1, (2, 6))
    assert best_shrinkage(together, sensed, fold) == min(SHRUNK)
    # Twelve numbers that have nothing to do with one another seem to, in eight stretches.
    apart = (3 * own).unflatten(1, (2, 6))
    assert best_shrinkage(apart[:12], sensed, fold[:12]) == max(SHRUNK)


def test_steps_lack_the_acceleration_of_the_missing_drag(wrong):
    inputs, lacking = lacking_acceleration(Player(simulator), wrong)
    vx, ax = inputs[..., 0].flatten(), lacking[..., 0].flatten()
    slope = float((vx * ax).mean() / vx.square().mean())
    assert slope == pytest.approx(-RATE, abs=0.08)


def test_a_correction_closes_what_the_simulator_gets_wrong(wrong, another):
    found = correct(Player(simulator), wrong)
    assert found.effect is not None
    assert found.after - 1 < 0.5 * (found.before - 1)
    weighed = likelihood(Player(simulator), another)
    before, after = (
        float(weighed.white(player.play(another, {})).square().mean(-1).median())
        for player in (Player(simulator), found.player(Player(simulator)))
    )
    assert after - 1 < 0.5 * (before - 1)


def test_what_is_held_out_of_the_baseline_foretells_new_drives(wrong, another):
    found = correct(Player(simulator), wrong)
    player = found.player(Player(simulator))

    def size(cut):
        weighed = likelihood(player, cut, extra=found.covariance)
        square = weighed.white(player.play(cut, {}))[0].square().sum(-1)
        return misfit(square / weighed.readings)

    assert found.held_out.shape == (len(wrong),)
    assert misfit(found.held_out) > size(wrong)  # the covariance was made from these
    crossed = found.weighed.white(player.play(wrong, {}))[0].square().mean(-1)
    assert misfit(crossed) > size(wrong)  # and not that by which they are weighed against others
    assert misfit(found.held_out) == pytest.approx(size(another), rel=0.15)


def test_a_simulator_that_is_right_gets_no_covariance_that_matters(right):
    found = correct(Player(simulator), right)
    assert found.after < 1.5
    sensed = sensed_covariance(Player(simulator), right)
    assert float(found.covariance.diagonal().sum() / sensed.diagonal().sum()) < 1.0


def test_the_same_seed_learns_the_same_network(wrong):
    data = lacking_acceleration(Player(simulator), wrong[torch.arange(10)])
    first, second = trained(*data, seed=3), trained(*data, seed=3)
    probe = torch.randn(5, 8)
    assert torch.equal(first(probe), second(probe))


def test_standing_effects_are_in_every_rollout(wrong):
    effect = make_effect("viscous_drag", rate=RATE)
    standing = Player(simulator, standing=(effect,)).play(wrong, {})
    on_trial = Player(simulator).play(wrong, {"viscous_drag": {"rate": torch.tensor([RATE])}})
    torch.testing.assert_close(standing, on_trial)
    assert not torch.equal(standing, Player(simulator).play(wrong, {}))


def test_a_baseline_without_anything_to_hold_out_is_refused(wrong):
    few = wrong[wrong.row < 100]
    assert len(few) > 0
    with pytest.raises(ValueError, match="record at least 24 s"):
        correct(Player(simulator), few)
