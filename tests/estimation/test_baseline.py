from dataclasses import replace

import pytest
import torch

from buggy_rl.effects import make_effect
from buggy_rl.estimation.baseline import (
    SHRINKAGES,
    best_shrinkage,
    correct,
    lacking_acceleration,
    sensed_covariance,
    standing_covariance,
    trained,
)
from buggy_rl.estimation.evidence import misfit
from buggy_rl.estimation.noise_model import noise_model
from buggy_rl.estimation.rollout import ParameterSets, Simulation
from buggy_rl.estimation.segments import cut_segments
from buggy_rl.policies.controllers.recording import recorded_steps
from buggy_rl.policies.controllers.room import RoomDriver
from buggy_rl.recordings import Recording
from buggy_rl.recordings.camera import Camera, CameraConfig
from buggy_rl.simulators import make_engine
from tests.effects.faults import batched, over

RATE = 0.8  # [1/s] viscous drag of the wrong car, unknown to the simulator
SECONDS = 25.0


def simulator(cars):
    return make_engine("single_track", cars)


@pytest.fixture(scope="module")
def drives():
    """Segments of three drives as a camera sees them: of a right car, and two of a wrong one."""
    car = over(
        [batched("viscous_drag", [{"rate": r} for r in (0.0, RATE, RATE)])], "single_track", 3
    )
    rows = list(recorded_steps(car, RoomDriver(seed=0), round(SECONDS / 0.01)))
    seen = [Camera(CameraConfig(), i).recorded(true) for i, true in enumerate(torch.stack(rows, 1))]
    return [cut_segments([Recording("drive", data, 0.01)], 0.5, 0.5) for data in seen]


@pytest.fixture(scope="module")
def right(drives):
    return drives[0]


@pytest.fixture(scope="module")
def wrong(drives):
    return drives[1]


@pytest.fixture(scope="module")
def another(drives):
    return drives[2]


@pytest.fixture(scope="module")
def found(wrong):
    return correct(Simulation(simulator), wrong)


@pytest.mark.slow
def test_residuals_of_the_sensor_alone_have_no_standing_covariance(right):
    sensed = sensed_covariance(Simulation(simulator), right)
    torch.manual_seed(0)
    noise = torch.randn(20_000, len(sensed), dtype=torch.float64)
    residual = (noise @ torch.linalg.cholesky(sensed).mT).unflatten(1, (-1, 6))
    # The largest eigenvalue of a sample of n is (1 + sqrt(D / n))^2 = 1.08 for D = 30, n = 20 000.
    over_sensed = torch.linalg.solve(sensed, standing_covariance(residual, sensed, 0.2))
    assert float(torch.linalg.eigvals(over_sensed).real.max()) < 0.1


def test_a_standing_error_is_found_at_its_size():
    # e = s u with s ~ N(0, 9) along one direction u of D = 12 with unit noise: C = 9 u u^T, of
    # which the shrinking to the diagonal keeps 80 % of what is off it.
    torch.manual_seed(0)
    u = torch.full((12,), 12**-0.5, dtype=torch.float64)
    residual = torch.randn(20_000, 12, dtype=torch.float64)
    residual += 3 * torch.randn(20_000, 1, dtype=torch.float64) * u
    got = standing_covariance(
        residual.unflatten(1, (2, 6)), torch.eye(12, dtype=torch.float64), 0.2
    )
    # Along u: 0.8 (1 + 9) + 0.2 (1 + 9 / 12) - 1 = 7.35; across nothing but 0.2 * 0.75 = 0.15.
    assert float(u @ got @ u) == pytest.approx(7.35, rel=0.05)
    across = torch.eye(12, dtype=torch.float64) - torch.outer(u, u)
    assert float((across @ got @ across).diagonal().sum()) / 11 == pytest.approx(0.15, abs=0.05)


def test_one_spin_among_many_segments_counts_as_no_more_than_its_cap():
    torch.manual_seed(0)
    residual = torch.randn(1000, 1, 6)
    residual[0] = 900.0
    got = standing_covariance(residual, torch.eye(6, dtype=torch.float64), 0.2)
    # It adds 25 * 6 / 1000 = 0.15 to the trace, not 6 * 900^2 / 1000 = 4860.
    assert float(got.diagonal().sum()) < 0.5


def test_correlation_between_readings_is_kept_with_many_segments_and_shrunk_with_few():
    generator = torch.Generator().manual_seed(0)
    common, own = (torch.randn(900, n, generator=generator, dtype=torch.float64) for n in (1, 12))
    sensed, fold = torch.eye(12, dtype=torch.float64), torch.arange(900) % 3
    together = (2 * common + own).unflatten(1, (2, 6))
    assert best_shrinkage(together, sensed, fold) == min(SHRINKAGES)
    # Twelve independent numbers have a large sample correlation in eight segments.
    apart = (3 * own).unflatten(1, (2, 6))
    assert best_shrinkage(apart[:12], sensed, fold[:12]) == max(SHRINKAGES)


def test_steps_lack_the_acceleration_of_the_missing_drag(wrong):
    inputs, lacking = lacking_acceleration(Simulation(simulator), wrong)
    vx, ax = inputs[..., 0].flatten(), lacking[..., 0].flatten()
    slope = float((vx * ax).mean() / vx.square().mean())
    assert slope == pytest.approx(-RATE, abs=0.08)


def test_a_correction_closes_what_the_simulator_gets_wrong(found, another):
    assert found.effect is not None
    assert found.after - 1 < 0.5 * (found.before - 1)
    noise = noise_model(Simulation(simulator), another)
    before, after = (
        float(noise.whiten(simulation.residuals(another)).square().mean(-1).median())
        for simulation in (Simulation(simulator), found.simulation(Simulation(simulator)))
    )
    assert after - 1 < 0.5 * (before - 1)


def test_the_held_out_misfit_of_the_baseline_predicts_that_of_new_recordings(found, wrong, another):
    simulation = found.simulation(Simulation(simulator))

    def of(segments):
        noise = noise_model(simulation, segments, extra=found.covariance)
        square = noise.whiten(simulation.residuals(segments))[0].square().sum(-1)
        return misfit(square / noise.dimension)

    assert found.held_out.shape == (len(wrong),)
    assert misfit(found.held_out) > of(wrong)  # the covariance was made from these
    crossed = found.noise.whiten(simulation.residuals(wrong))[0].square().mean(-1)
    assert misfit(crossed) > of(wrong)  # and the noise model's was made from the other folds
    assert misfit(found.held_out) == pytest.approx(of(another), rel=0.15)


@pytest.mark.slow
def test_a_simulator_that_is_right_gets_no_covariance_that_matters(right):
    found = correct(Simulation(simulator), right)
    assert found.after < 1.5
    sensed = sensed_covariance(Simulation(simulator), right)
    assert float(found.covariance.diagonal().sum() / sensed.diagonal().sum()) < 1.0


def test_the_same_seed_learns_the_same_network(wrong):
    data = lacking_acceleration(Simulation(simulator), wrong[torch.arange(10)])
    first, second = trained(*data, seed=3), trained(*data, seed=3)
    probe = torch.randn(5, 8)
    assert torch.equal(first(probe), second(probe))


def test_standing_effects_are_in_every_rollout(wrong):
    effect = make_effect("viscous_drag", rate=RATE)
    standing = Simulation(simulator, standing=(effect,)).residuals(wrong)
    drag = ParameterSets({"viscous_drag": {"rate": torch.tensor([RATE])}})
    torch.testing.assert_close(standing, Simulation(simulator).residuals(wrong, drag))
    assert not torch.equal(standing, Simulation(simulator).residuals(wrong))


def test_a_baseline_without_anything_to_hold_out_is_refused(wrong):
    few = wrong[wrong.row < 100]
    assert len(few) > 0
    with pytest.raises(ValueError, match="record at least 24 s"):
        correct(Simulation(simulator), few)


def test_commands_beyond_their_range_are_looked_at_as_the_car_takes_them(wrong):
    much = replace(wrong, action=4 * wrong.action)
    at_most = replace(wrong, action=(4 * wrong.action).clamp(-1, 1))
    for left, right in zip(
        *(lacking_acceleration(Simulation(simulator), part) for part in (much, at_most)),
        strict=True,
    ):
        torch.testing.assert_close(left, right)
