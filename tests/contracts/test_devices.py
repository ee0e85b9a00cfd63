"""Every PyTorch engine, the task over it and what drives it compute where they are told to."""

import pytest
import torch
from torch.testing import assert_close
from torchrl.data import Unbounded
from torchrl.envs import EnvBase

from buggy_rl.core import keys
from buggy_rl.effects import EFFECTS, effect_class
from buggy_rl.effects.actuation.command import RememberingCommand
from buggy_rl.effects.actuation.supply import ThermalFoldback
from buggy_rl.effects.base import Effect
from buggy_rl.estimation.rollout import ParameterSets, Simulation
from buggy_rl.estimation.segments import cut_segments
from buggy_rl.policies.closed_loop import TrackReset, drive
from buggy_rl.simulators import ENGINES, base, make_engine
from buggy_rl.simulators.learned import MODELS
from buggy_rl.simulators.learned.factory import ModelConfig, make_model
from buggy_rl.simulators.reference import engine as reference
from buggy_rl.task.config import TaskConfig
from buggy_rl.task.env import make_env
from buggy_rl.task.paths.making import make_paths
from buggy_rl.task.transforms import waypoints
from tests.drives import counting_drive

PYTORCH = [
    *(name for name in ENGINES if name not in ("mujoco", "learned")),
    *(f"learned {model}" for model in MODELS),
]


def make(name: str, device: str):
    engine, _, kind = name.partition(" ")
    torch.manual_seed(0)
    options = {"model": make_model(ModelConfig(kind))} if kind else {}
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


PATHS = make_paths(TaskConfig().paths)


@pytest.mark.usefixtures("contentless")
def test_a_task_is_computed_where_its_engine_is():
    env = make_env(make("kinematic", "meta"), paths=PATHS)
    state = env.reset()
    state[keys.ACTION] = torch.zeros(4, 2, device="meta")
    after = env.step(state)
    assert {str(value.device) for value in after.values(True, True)} == {"meta"}


@pytest.mark.usefixtures("contentless")
def test_an_episode_is_scored_where_its_environment_is():
    env = make_env(make("kinematic", "meta"), paths=PATHS)

    def straight(state):
        return state.set(keys.ACTION, torch.zeros(4, 2, device="meta"))

    for track_reset in (None, TrackReset(env)):
        scores = drive(env, straight, 3, track_reset)
        assert str(scores.waypoints.device) == "meta"


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
