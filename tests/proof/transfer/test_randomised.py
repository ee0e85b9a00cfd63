"""Cars with physics drawn at random."""

import pytest
import torch

from buggy_rl.proof.transfer.parameter_posterior import MUJOCO, SPREADS, randomised
from buggy_rl.simulators import make_engine
from buggy_rl.simulators.base import Engine

CARS = 400


def values(seed: int) -> dict[str, torch.Tensor]:
    torch.manual_seed(seed)
    engine = randomised("mujoco", CARS)
    assert isinstance(engine, Engine)
    return engine.values


@pytest.fixture(scope="module")
def drawn() -> dict[str, torch.Tensor]:
    return values(0)


def shipped(name: str) -> float:
    engine = make_engine("mujoco", 1)
    assert isinstance(engine, Engine)
    return float(engine.values[name])


@pytest.mark.parametrize("simulator", list(SPREADS))
def test_every_declared_spread_is_of_a_parameter_that_its_engine_has(simulator):
    engine = make_engine(simulator, 1)
    assert isinstance(engine, Engine)
    named = {name for spread in SPREADS[simulator] for name in spread.names}
    assert named <= set(engine.declared)


def test_a_single_track_is_drawn_by_its_own_ranges():
    torch.manual_seed(0)
    engine = randomised("single_track", CARS)
    assert isinstance(engine, Engine)
    plain = make_engine("single_track", 1)
    assert isinstance(plain, Engine)
    factor = engine.values["rear_grip"] / plain.values["rear_grip"]
    assert 0.7 <= float(factor.min()) < 0.712
    assert 1.088 < float(factor.max()) <= 1.1
    trim = engine.values["steering_offset"] - plain.values["steering_offset"]
    assert 0.075 < float(trim.max()) <= 0.08


def test_no_two_cars_are_alike(drawn):
    rows = torch.stack([drawn[name] for spread in MUJOCO for name in spread.names], -1)
    assert len(rows.unique(dim=0)) == CARS


def test_factors_fill_their_range(drawn):
    # Evenly in [0.75, 1.25]: of 400 the outermost are within 3 % of its ends but in 1 of 1e5 cases.
    factor = drawn["mass"] / shipped("mass")
    assert 0.75 <= float(factor.min()) < 0.765
    assert 1.235 < float(factor.max()) <= 1.25


def test_delays_are_only_added(drawn):
    late = drawn["steering_dead_time"] - shipped("steering_dead_time")
    assert float(late.min()) >= 0.0
    assert 0.075 < float(late.max()) <= 0.08


def test_one_floor_is_under_all_wheels(drawn):
    # Front over rear is the wear of the tyres alone: 0.9 to 1.1.
    ratio = drawn["grip_front"] / drawn["grip_rear"] * shipped("grip_rear") / shipped("grip_front")
    assert 0.9 <= float(ratio.min()) < 0.91
    assert 1.09 < float(ratio.max()) <= 1.1
    assert float(drawn["grip_rear"].std()) > 0.05


def test_a_seed_fixes_the_cars(drawn):
    assert all(torch.equal(drawn[name], value) for name, value in values(0).items())
    assert not torch.equal(drawn["mass"], values(1)["mass"])


def test_values_stay_within_what_the_simulator_allows():
    torch.manual_seed(0)
    engine = randomised("mujoco", CARS)
    assert isinstance(engine, Engine)
    for name, parameter in engine.declared.items():
        assert float(engine.values[name].min()) >= parameter.lower - 1e-6
        assert float(engine.values[name].max()) <= parameter.upper + 1e-6


def test_a_simulator_without_parameters_is_refused():
    with pytest.raises(ValueError, match="hold has no parameters that could be drawn"):
        randomised("hold", 4)
