"""Every PyTorch engine, the task over it and what drives it compute where they are told to."""

from dataclasses import fields
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from tensordict import TensorDict
from torch.testing import assert_close
from torchrl.data import Unbounded
from torchrl.envs import EnvBase

from buggy_rl.core import keys
from buggy_rl.effects import EFFECTS, effect_class
from buggy_rl.effects.actuation.command import RememberingCommand
from buggy_rl.effects.actuation.supply import ThermalFoldback
from buggy_rl.effects.base import Effect
from buggy_rl.effects.residual_models import ResidualNetwork
from buggy_rl.estimation.rollout import ParameterSets, Simulation
from buggy_rl.estimation.segments import cut_segments
from buggy_rl.policies.closed_loop import TrackReset, drive
from buggy_rl.policies.controllers.path_tracking import (
    PurePursuit,
    PurePursuitConfig,
    Stanley,
    StanleyConfig,
)
from buggy_rl.policies.controllers.tuning import TuningConfig, tune
from buggy_rl.proof.transfer import parameter_posterior
from buggy_rl.proof.transfer.parameter_posterior import Spread, fitted_with_spread
from buggy_rl.simulators import ENGINES, base, make_engine
from buggy_rl.simulators.learned import MODELS
from buggy_rl.simulators.learned.factory import ModelConfig, make_model
from buggy_rl.simulators.reference import engine as reference
from buggy_rl.simulators.serial import SerialBatch, SinglePrecision
from buggy_rl.task.config import TaskConfig
from buggy_rl.task.env import TaskEnv, make_env
from buggy_rl.task.gym_vector import WaypointsVectorEnv
from buggy_rl.task.paths.making import make_paths
from buggy_rl.task.transforms import waypoints
from tests.drives import counting_drive

PYTORCH = [
    *(name for name in ENGINES if name not in ("mujoco", "learned", "surrogate")),
    *(f"learned {model}" for model in MODELS),
    "surrogate mlp",
]


def make(name: str, device: str):
    engine, _, kind = name.partition(" ")
    torch.manual_seed(0)
    options: dict[str, Any] = {"model": make_model(ModelConfig(kind))} if kind else {}
    if engine == "surrogate":
        options["simulator"] = "kinematic"
    return make_engine(engine, 4, device, **options)


def step(engine):
    state = engine._reset(None)
    state["action"] = torch.full((4, 2), 0.3, device=engine.device)
    return engine._step(state)


def test_the_meta_device_refuses_tensors_of_another_device():
    with pytest.raises(RuntimeError):
        torch.ones(3, device="meta") + torch.ones(3)


@pytest.fixture
def contentless(monkeypatch: pytest.MonkeyPatch):
    """Takes out checks of content: of TorchRL's bounds, of flags, and of our own parameters.

    Meta tensors have a device but no content: what runs on them runs on a GPU as well.
    """
    monkeypatch.setattr(
        base, "Bounded", lambda _low, _high, shape, **kind: Unbounded(shape, **kind)
    )
    monkeypatch.setattr(waypoints, "COUNT", Unbounded(torch.Size([1]), dtype=torch.int64))
    monkeypatch.setattr(reference, "refuse_of_another_command", lambda *_: None)
    monkeypatch.setattr(EnvBase, "_reset_check_done", lambda *_: None)
    monkeypatch.setattr(torch, "allclose", lambda *_, **__: True)
    monkeypatch.setattr(torch.Tensor, "__bool__", lambda _: True)


@pytest.mark.usefixtures("contentless")
@pytest.mark.parametrize("name", PYTORCH)
def test_no_step_mixes_devices(name: str):
    result = step(make(name, "meta"))
    assert {str(value.device) for value in result.values()} == {"meta"}


@pytest.mark.usefixtures("contentless")
@pytest.mark.parametrize("name", PYTORCH)
def test_an_engine_that_was_moved_steps_where_it_is(name: str):
    engine = make(name, "cpu").to("meta")
    held = [*engine.values.values(), *engine.state_dict().values()]
    assert {str(value.device) for value in held} <= {"meta"}
    result = step(engine)
    assert {str(value.device) for value in result.values()} == {"meta"}


@pytest.mark.usefixtures("contentless")
def test_an_engine_with_parameters_of_its_own_keeps_them_when_it_is_moved():
    engine = make("single_track", "cpu")
    drawn = TensorDict({"mass": torch.linspace(1.0, 2.0, 4)}, [4])
    moved = engine.with_parameters(drawn).to("meta")
    assert moved.values["mass"].shape == (4,)
    assert {str(value.device) for value in step(moved).values()} == {"meta"}


def test_a_concealed_fault_is_moved_with_its_car(request: pytest.FixtureRequest):
    engine = make_engine("reference", 4, "cpu", faults={"tire_grip.grip": 0.7})
    request.getfixturevalue("contentless")  # not before: faults are checked by their content
    result = step(engine.to("meta"))
    assert {str(value.device) for value in result.values()} == {"meta"}


def test_a_move_to_where_an_engine_is_changes_nothing():
    engine = make("single_track", "cpu")
    before = step(engine)
    values = dict(engine.values)
    assert engine.to("cpu") is engine
    assert all(engine.values[name] is value for name, value in values.items())
    after = step(engine)
    for key, value in before.items():
        assert_close(after[key], value, atol=0.0, rtol=0.0)


@pytest.mark.usefixtures("contentless")
@pytest.mark.parametrize("wrap", [SinglePrecision, lambda engine: SerialBatch(engine, 1)])
def test_a_wrapped_simulator_is_moved_with_what_wraps_it(wrap):
    env = wrap(make_engine("single_track", (), "cpu")).to("meta")
    state = env._reset(None)
    state["action"] = torch.zeros(*env.batch_size, 2, device="meta")
    assert {str(value.device) for value in env._step(state).values()} == {"meta"}


PATHS = make_paths(TaskConfig().paths)


@pytest.mark.usefixtures("contentless")
def test_a_task_is_computed_where_its_engine_is():
    env = make_env(make("kinematic", "meta"), paths=PATHS)
    state = env.reset()
    state[keys.ACTION] = torch.zeros(4, 2, device="meta")
    after = env.step(state)
    assert {str(value.device) for value in after.values(True, True)} == {"meta"}


def on_meta():
    return make_env(make("kinematic", "meta"), paths=PATHS)


def moved_there():
    return make_env(make("kinematic", "cpu"), paths=PATHS).to("meta")


@pytest.mark.usefixtures("contentless")
@pytest.mark.parametrize("environment", [on_meta, moved_there])
def test_an_episode_is_scored_where_its_environment_is(environment):
    env = environment()

    def straight(state):
        return state.set(keys.ACTION, torch.zeros(4, 2, device="meta"))

    for track_reset in (None, TrackReset(env)):
        scores = drive(env, straight, 3, track_reset)
        assert {str(getattr(scores, f.name).device) for f in fields(scores)} == {"meta"}


@pytest.fixture
def read_as_zeros(monkeypatch: pytest.MonkeyPatch):
    """What is read of a meta tensor is zeros: a search ranks what it drove by such numbers."""

    def zeros(tensor: torch.Tensor):
        return torch.zeros_like(tensor, device="cpu")

    monkeypatch.setattr(torch.Tensor, "cpu", zeros)
    read = torch.Tensor.tolist

    def tolist(tensor: torch.Tensor):
        return read(zeros(tensor) if tensor.is_meta else tensor)

    monkeypatch.setattr(torch.Tensor, "tolist", tolist)


@pytest.mark.usefixtures("contentless", "read_as_zeros")
@pytest.mark.parametrize("driver", [PurePursuit, Stanley])
def test_a_controller_is_tuned_where_its_environment_is(driver):
    config = {PurePursuit: PurePursuitConfig, Stanley: StanleyConfig}[driver]()
    best, trials = tune(on_meta(), 2, driver, config, TuningConfig(steps=2, rounds=2))
    assert isinstance(best, type(config))
    assert len(trials) == 4


@pytest.mark.usefixtures("contentless", "read_as_zeros")
def test_cars_that_differ_by_what_a_fit_left_open_are_where_they_are_asked_for(tmp_path):
    fitted, repaired = tmp_path / "fitted.yaml", tmp_path / "repaired.yaml"
    interval = {"low": 1.5, "high": 1.7}
    fitted.write_text(yaml.safe_dump({"engine": "single_track", "_fit": {"mass": interval}}))
    correction = tmp_path / "correction.pt"
    ResidualNetwork().save(correction)
    effects = {
        "residual_acceleration": {"model": str(correction)},
        "steering_dead_time": {"dead_time": 0.02},
    }
    repaired.write_text(yaml.safe_dump({"engine": "fitted.yaml", "effects": effects}))
    env = make_env(fitted_with_spread(repaired, 4, "meta"), paths=PATHS)
    assert {str(value.device) for value in env.base_env.values.values()} == {"meta"}
    state = env.reset()
    state[keys.ACTION] = torch.zeros(4, 2, device="meta")
    after = env.step(state)
    assert {str(value.device) for value in after.values(True, True)} == {"meta"}


@pytest.mark.usefixtures("contentless", "read_as_zeros")
def test_cars_with_drawn_parameters_are_where_they_are_asked_for(monkeypatch):
    few = (Spread(("mass",), 0.75, 1.25, False, ""), Spread(("mass",), 0.0, 0.1, True, ""))
    monkeypatch.setattr(parameter_posterior, "SPREADS", {"single_track": few})
    engine = parameter_posterior.randomised("single_track", 4, "meta")
    assert {str(value.device) for value in step(engine).values()} == {"meta"}


@pytest.mark.usefixtures("contentless", "read_as_zeros")
def test_gymnasium_is_given_arrays_of_an_environment_on_another_device(monkeypatch):
    monkeypatch.setattr(TaskEnv, "set_seed", lambda *_: None)  # meta has no generator,
    monkeypatch.setattr("torch.fx.experimental._config.meta_nonzero_assume_all_nonzero", True)
    envs = WaypointsVectorEnv(4, "kinematic", paths=PATHS, device="meta")
    envs.reset(options={"path": [0, 1, 2, 3]})
    observation, rewards, *_ = envs.step(np.zeros((4, 2), np.float32))
    assert (observation.shape, rewards.shape) == ((4, 23), (4,))
    assert str(envs._env.device) == "meta"


SETS = 2
PLAIN = Effect.unsensed
# Effects that a rollout asks for more than their steps, which tests/contracts/test_effects.py has.
ASKED = [
    name
    for name in EFFECTS
    if effect_class(name).unsensed is not PLAIN
    or issubclass(effect_class(name), (RememberingCommand, ThermalFoldback))
]


FEW = ["thermal_foldback", "throttle_lag", "sensor_latency", "sensor_lag"]  # of each kind


@pytest.mark.usefixtures("contentless")
@pytest.mark.parametrize(
    "names", [FEW, pytest.param(ASKED, marks=pytest.mark.slow)], ids=["few", "all"]
)
def test_rollouts_of_a_diagnosis_run_where_the_simulator_is(names, monkeypatch):
    monkeypatch.setattr(torch.Tensor, "cpu", lambda tensor: torch.zeros(tensor.shape))
    segments = cut_segments([counting_drive("a", 40)], 0.02, 0.02)
    effects = {
        name: {p.name: torch.full((SETS,), p.value + p.probe) for p in effect_class(name).declared}
        for name in names
    }
    settings = ParameterSets(effects, {"mass": torch.ones(SETS)}, torch.full((SETS,), 0.01))
    # Steps take long on the meta device; those of the other engines are tried above.
    simulation = Simulation(lambda cars: make_engine("kinematic", cars, "meta"), every=1)
    residuals = simulation.residuals(segments, settings, torch.zeros(SETS, 6))
    assert residuals.shape == (SETS, len(segments), 2, 6)
    for _, imposed, after in simulation.single_steps(segments, settings):
        assert imposed.device == after.device == segments.pose.device


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU here")
@pytest.mark.parametrize("name", PYTORCH)
def test_a_gpu_gives_the_same_step_as_the_cpu(name: str):
    on_cpu, on_gpu = step(make(name, "cpu")), step(make(name, "cuda"))
    for key, value in on_cpu.items():
        assert_close(on_gpu[key].cpu(), value, atol=1e-4, rtol=1e-3)
