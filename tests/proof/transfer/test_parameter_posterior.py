"""Cars that differ by what a fit left open."""

import pytest
import torch
import yaml
from torchrl.envs import TransformedEnv

from buggy_rl.core import keys
from buggy_rl.effects.residual_models import ResidualNetwork
from buggy_rl.proof.transfer.parameter_posterior import fitted_with_spread
from buggy_rl.simulators.base import Engine
from buggy_rl.simulators.bicycle.single_track import SingleTrackEngine
from buggy_rl.task.env import make_env

CARS = 400
LAG = {"time_constant": 0.05}
FITTED = {
    "engine": "mujoco",
    "parameters": {"mass": 2.0, "steering_lag": 0.03, "grip_front": 0.9},
    "_fit": {
        "steering_lag": {"low": 0.02, "high": 0.04},
        "grip_front": {"low": 0.7, "high": 1.0},
    },
}


@pytest.fixture
def fitted(tmp_path) -> str:
    file = tmp_path / "fitted.yaml"
    file.write_text(yaml.safe_dump(FITTED))
    return str(file)


def written(tmp_path, **content) -> str:
    file = tmp_path / "deeper" / "repaired.yaml"
    file.parent.mkdir(exist_ok=True)
    file.write_text(yaml.safe_dump({"engine": "../fitted.yaml", **content}))
    return str(file)


def values(simulator: str, seed: int = 0) -> dict[str, torch.Tensor]:
    torch.manual_seed(seed)
    engine = fitted_with_spread(simulator, CARS)
    assert isinstance(engine, Engine)
    return engine.values


def test_draws_fill_twice_the_interval_and_nothing_else_moves(fitted):
    drawn = values(fitted)
    # About 0.9: 0.7 .. 1.0 is 0.5 .. 1.1. Of 400 even draws the outermost are within 3 % of the
    # ends but in 1 of 1e5 cases.
    assert 0.5 <= float(drawn["grip_front"].min()) < 0.518
    assert 1.082 < float(drawn["grip_front"].max()) <= 1.1
    assert float(drawn["mass"].min()) == float(drawn["mass"].max()) == 2.0
    assert abs(torch.stack([drawn["grip_front"], drawn["steering_lag"]]).corrcoef()[0, 1]) < 0.2


def test_draws_stay_within_what_the_simulator_allows(tmp_path):
    lag = {"steering_lag": {"low": 0.0, "high": 0.01}}
    file = tmp_path / "quick.yaml"
    content = {"engine": "mujoco", "parameters": {"steering_lag": 0.002}, "_fit": lag}
    file.write_text(yaml.safe_dump(content))
    drawn = values(str(file))["steering_lag"]
    # -0.002 .. 0.018 before what is below nothing is put there.
    assert float(drawn.min()) == 0.0
    assert 0.017 < float(drawn.max()) <= 0.018


def test_a_seed_fixes_the_cars(fitted):
    assert torch.equal(values(fitted)["grip_front"], values(fitted)["grip_front"])
    assert not torch.equal(values(fitted)["grip_front"], values(fitted, 1)["grip_front"])


def test_what_was_tuned_again_is_not_drawn(fitted, tmp_path):
    drawn = values(written(tmp_path, parameters={"grip_front": 0.5, "mass": 2.5}))
    assert drawn["grip_front"].unique().tolist() == [0.5]
    assert drawn["mass"].unique().tolist() == [2.5]
    assert len(drawn["steering_lag"].unique()) > CARS / 2


def test_effects_stand_over_it_as_they_are(fitted, tmp_path):
    late = {"steering_dead_time": {"dead_time": 0.1}}
    torch.manual_seed(0)
    cars = make_env(fitted_with_spread(written(tmp_path, effects=late), 8))
    action = torch.tensor([[0.6, 0.8]]).repeat(8, 1)
    rows = cars.rollout(40, lambda td: td.set(keys.ACTION, action))
    turned = rows["next", keys.VELOCITY][..., 2]
    assert len(rows["next", keys.VELOCITY][:, -1, 0].unique()) == 8
    torch.manual_seed(0)
    plain = make_env(fitted_with_spread(fitted, 8)).rollout(
        40, lambda td: td.set(keys.ACTION, action)
    )
    before = plain["next", keys.VELOCITY][..., 2]
    # The same cars, that turn ten steps later.
    assert float(before[:, 9].abs().min()) > 10 * float(turned[:, 9].abs().max())


def single_track(tmp_path, **content) -> str:
    """A single track that was fitted, under a file with `content`."""
    interval = {"front_grip": {"low": 0.5, "high": 0.7}}
    fitted = {"engine": "single_track", "parameters": {"front_grip": 0.6}, "_fit": interval}
    (tmp_path / "fitted.yaml").write_text(yaml.safe_dump(fitted))
    return written(tmp_path, **content)


def test_options_of_a_repaired_simulator_hold_for_its_cars(tmp_path):
    # A diagnosis writes the finer step that it took.
    engine = fitted_with_spread(single_track(tmp_path, options={"substeps": 4}), CARS)
    assert isinstance(engine, SingleTrackEngine)
    assert engine.substeps == 4
    assert len(engine.values["front_grip"].unique()) > CARS / 2
    slow = single_track(tmp_path, options={"dt": 0.02}, effects={"steering_lag": LAG})
    env = fitted_with_spread(slow, CARS)
    assert isinstance(env, TransformedEnv)
    (effect,) = env.transform
    assert env.dt == effect.dt == 0.02


def test_each_car_of_a_repaired_single_track_passes_gradients_of_its_own(tmp_path):
    late = {"steering_dead_time": {"dead_time": 0.015}, "steering_lag": LAG}
    cars = make_env(fitted_with_spread(single_track(tmp_path, effects=late), 8))
    action = torch.tensor([[0.6, 0.3]]).repeat(8, 1).requires_grad_()
    end = cars.rollout(30, lambda td: td.set(keys.ACTION, action))["next", keys.POSE][:, -1, 2]
    (slope,) = torch.autograd.grad(end.sum(), action)
    assert slope[:, 1].min() > 0  # more to the left turns more to the left
    assert len(slope[:, 1].unique()) == 8


def test_of_a_correction_cars_feel_from_nothing_to_twice(fitted, tmp_path):
    file = written(
        tmp_path, effects={"residual_acceleration": {"strength": 0.5, "model": "correction.pt"}}
    )
    ResidualNetwork().save(tmp_path / "deeper" / "correction.pt")
    torch.manual_seed(0)
    env = fitted_with_spread(file, CARS)
    assert isinstance(env, TransformedEnv)
    (effect,) = env.transform
    strength = effect.values["strength"]
    assert 0.0 <= float(strength.min()) < 0.03
    assert 0.97 < float(strength.max()) <= 1.0


@pytest.mark.parametrize("simulator", ["mujoco", "unfitted.yaml"])
def test_a_simulator_that_was_not_fitted_is_refused(simulator, tmp_path):
    (tmp_path / "unfitted.yaml").write_text("engine: mujoco\n")
    place = str(tmp_path / simulator) if simulator.endswith("yaml") else simulator
    with pytest.raises(ValueError, match=r"mujoco has no intervals .*scripts/fit_mujoco"):
        fitted_with_spread(place, 4)
