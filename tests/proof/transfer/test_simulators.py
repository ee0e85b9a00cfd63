"""Arms' simulators: each made from the right parents."""

import json
from dataclasses import replace

import pytest
import torch
import yaml

from buggy_rl.core import keys
from buggy_rl.core.files import write_atomically
from buggy_rl.proof.cases.drives import plant_parameters
from buggy_rl.proof.transfer.arms import ARMS
from buggy_rl.proof.transfer.plan import TransferConfig
from buggy_rl.proof.transfer.simulators import write_simulators
from buggy_rl.simulators import read_simulator
from buggy_rl.simulators.learned.factory import ModelConfig, save_model
from buggy_rl.simulators.reference import ReferenceEngine
from buggy_rl.simulators.surrogate import SurrogateEngine
from buggy_rl.task.env import make_simulator
from tests.contracts.test_engines import untrained_model

LATE = {"steering_dead_time": {"dead_time": 0.08}}
MODEL = ModelConfig("mlp", options={"rows": 3})
LAG = {"steering_lag": {"time_constant": 0.1}}


def fitted(mass, grip):
    interval = {"front_grip": {"low": grip - 0.05, "high": grip + 0.05}}
    numbers = {"mass": mass, "front_grip": grip}
    return {"engine": "single_track", "parameters": numbers, "_fit": interval}


def write(file, content):
    write_atomically(file, yaml.safe_dump(content))


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """Three cars with files as fits, diagnoses and models leave them; the last one is right."""
    config = TransferConfig(str(tmp_path_factory.mktemp("out")), cars=3, seeds=[0])
    drawn = config.drawn("a secret").items()
    hidden = ({"throttle_gain": {"gain": 0.8}}, LATE, {})
    cases = {
        name: replace(case, concealed=own) for (name, case), own in zip(drawn, hidden, strict=True)
    }
    for number, car in enumerate(cases):
        write(config.fitted(car), fitted(1.5 + 0.1 * number, 0.6 + 0.1 * number))
        write(config.fitted(car, "refit"), fitted(9.0, 0.5))
        for folder in ("before", "learned"):
            save_model(untrained_model(), MODEL, config.model_of(car, folder), {"dt": 0.01})
        engine = f"../fit/{config.fitted(car).name}"
        write(config.repaired(car), {"engine": engine})
        write_atomically(config.answer(car), json.dumps({"effects": []}))
    repair = {"engine": "../fit/single_track_fitted.yaml", "parameters": {"front_grip": 0.5}}
    repair |= {"options": {"substeps": 4}, "effects": LAG}
    write(config.repaired("02"), repair)
    write_simulators(config, cases)
    return config, cases


def engine_of(env):
    return getattr(env, "base_env", env)


def test_every_arm_is_a_simulator_that_drives(study):
    config, cases = study
    for car in cases:
        for arm in ARMS:
            torch.manual_seed(0)
            cars = make_simulator(config.simulator_of(arm, car), 2)
            state = cars.reset().set(keys.ACTION, torch.ones(2, 2))
            assert torch.isfinite(cars.step(state)["next", keys.VELOCITY]).all(), arm


def test_arms_stand_over_their_own_fit_with_the_gradients_of_their_own_model(study):
    config, _ = study
    expected = {"as_given": (1.6, 0.7, "before"), "refitted": (9.0, 0.5, "learned")}
    for arm, (mass, grip, model) in expected.items():
        file = config.car("02") / "simulators" / f"{arm}.yaml"
        engine = make_simulator(str(file), 1)
        assert isinstance(engine, SurrogateEngine)
        assert float(engine.values["mass"]) == pytest.approx(mass)
        assert float(engine.values["front_grip"]) == pytest.approx(grip)
        found = (file.parent / read_simulator(file)["options"]["model"]).resolve()
        assert found == config.model_of("02", model).resolve()


def test_a_repair_keeps_parameters_step_and_effects(study):
    config, _ = study
    env = make_simulator(config.simulator_of("repaired", "02"), 1)
    (effect,) = env.transform
    assert effect.name == "steering_lag"
    assert float(effect.values["time_constant"]) == pytest.approx(0.1)
    engine = engine_of(env)
    assert engine.simulator.substeps == 4
    assert float(engine.values["front_grip"]) == pytest.approx(0.5)
    assert float(engine.values["mass"]) == pytest.approx(1.6)
    continued = read_simulator(config.car("02") / "simulators" / "continued.yaml")
    assert continued == read_simulator(config.car("02") / "simulators" / "repaired.yaml")


def test_a_placebo_is_as_given_with_the_repair_of_the_next_car_of_its_kind(study):
    config, _ = study
    env = make_simulator(config.simulator_of("placebo", "01"), 1)
    (effect,) = env.transform
    assert effect.name == "steering_lag"
    engine = engine_of(env)
    # The other's grip was repaired from 0.7 to 0.5, so 0.6 becomes 0.4; the mass is the car's own.
    assert float(engine.values["front_grip"]) == pytest.approx(0.4)
    assert float(engine.values["mass"]) == pytest.approx(1.5)
    # Of two changed cars the first is the next one of the second; a single control has its own.
    for car in ("02", "03"):
        plain = make_simulator(config.simulator_of("placebo", car), 1)
        assert isinstance(plain, SurrogateEngine)
        own = make_simulator(config.simulator_of("as_given", car), 1)
        assert torch.equal(plain.values["front_grip"], own.values["front_grip"])


def test_the_truth_is_the_changed_car_itself(study):
    config, cases = study
    engine = make_simulator(config.simulator_of("truth", "02"), 1)
    assert isinstance(engine, SurrogateEngine)
    assert isinstance(engine.simulator, ReferenceEngine)
    faults = engine.simulator.car.faults
    assert float(faults["steering_dead_time.dead_time"]) == pytest.approx(0.08)
    own = plant_parameters(cases["02"])
    for name in ("mass", "yaw_inertia"):
        assert float(engine.values[name]) == pytest.approx(own[name], rel=1e-5)


def test_every_environment_of_a_drawn_arm_has_parameters_of_its_own(study):
    config, _ = study
    for arm in ("randomised", "repaired_randomised"):
        torch.manual_seed(0)
        engine = engine_of(make_simulator(config.simulator_of(arm, "02"), 50))
        assert len(engine.values["front_grip"].unique()) == 50, arm
