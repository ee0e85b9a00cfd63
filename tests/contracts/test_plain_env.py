"""A user's own simulator, which knows TorchRL alone, goes wherever ours go."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import EnvBase
from torchrl.envs.utils import check_env_specs

from buggy_rl.core import keys
from buggy_rl.core.config import build
from buggy_rl.diagnosis.preflight.simulator import check_simulator
from buggy_rl.effects import EFFECTS, effect_class, make_effect
from buggy_rl.policies.closed_loop import drive
from buggy_rl.policies.controllers.path_tracking import PurePursuit
from buggy_rl.policies.training.actor_critic import Policy, PolicyConfig
from buggy_rl.policies.training.ppo import PPO
from buggy_rl.policies.training.ppo_config import PPOConfig
from buggy_rl.simulators import make_engine
from buggy_rl.simulators.serial import SinglePrecision, in_single_precision
from buggy_rl.task.config import TaskConfig
from buggy_rl.task.env import make_env, make_simulator, with_effects
from tests import plain_env

FILE = "tests/plain_env.py"
SHARED = (keys.POSE, keys.VELOCITY, keys.ACTION, keys.REWARD)


@pytest.fixture(scope="module", autouse=True)
def gradients():
    """As usual: a policy learns."""


@pytest.fixture(autouse=True)
def at_the_root(monkeypatch, repository):
    """The simulator is named as from the root of the project."""
    monkeypatch.chdir(repository)


def task(*overrides):
    files = ["configs/task_waypoints.yaml", "paths.count=4", "paths.waypoints=60"]
    return build(TaskConfig, [*files, *overrides])


@pytest.fixture(params=["make", "make_declared"])
def name(request):
    return f"{FILE}:{request.param}"


@pytest.mark.parametrize("batch_size", [(), (4,), (2, 3)], ids=["one", "four", "two by three"])
def test_it_is_an_engine_in_single_precision(name, batch_size):
    engine = make_engine(name, batch_size)
    check_env_specs(engine)
    rows = engine.rollout(3)
    for key in SHARED:
        value = rows["next", key] if key != keys.ACTION else rows[key]
        assert value.dtype == torch.float32, key
    assert rows["motor_force"].dtype == rows["servo", "angle"].dtype == torch.float64


SLOWLY = [pytest.param(kind, marks=pytest.mark.slow) for kind in ("make", "make_declared")]


@pytest.mark.parametrize("kind", ["make_quick", *SLOWLY])
def test_nothing_is_found_amiss_in_it_before_a_diagnosis(kind):
    assert check_simulator(lambda count: make_engine(f"{FILE}:{kind}", count), kind) == []


def test_it_computes_in_its_own_precision():
    inner = plain_env.make(2)
    outer = SinglePrecision(plain_env.make(2))
    start = TensorDict({keys.VELOCITY: torch.tensor([[1.0, 0.2, 0.3], [2.0, 0.0, -0.5]])}, [2])
    action = torch.tensor([[0.1, 0.3], [0.2, -0.7]])
    given = start.clone().set(keys.VELOCITY, start[keys.VELOCITY].double())
    one, other = inner.reset(given), outer.reset(start, set_state=True)
    one = inner.step(one.set(keys.ACTION, action.double()))["next"]
    other = outer.step(other.set(keys.ACTION, action))["next"]
    for key in (keys.POSE, keys.VELOCITY):
        assert torch.equal(one[key].float(), other[key]), key
    assert torch.equal(one["servo", "angle"], other["servo", "angle"])


def test_an_engine_in_single_precision_is_left_as_it_is():
    engine = make_engine("kinematic", 2)
    assert in_single_precision(engine) is engine


def test_an_edit_of_the_state_is_honoured_and_two_steps_are_equal(name):
    engine = make_engine(name, 3)
    state = engine.reset(TensorDict({keys.POSE: torch.ones(3, 3)}, [3]), set_state=True)
    assert torch.equal(state[keys.POSE], torch.ones(3, 3))
    state[keys.VELOCITY] = torch.tensor([2.0, 0.0, 0.0]).expand(3, 3)
    state[keys.ACTION] = torch.zeros(3, 2)
    first, second = (engine.step(state.clone())["next"] for _ in range(2))
    assert (first == second).all()
    assert (first[keys.VELOCITY][:, 0] > 1.9).all()


def test_what_it_does_not_declare_is_not_there_and_what_it_does_is():
    bare, declared = make_engine(f"{FILE}:make", 2), make_engine(f"{FILE}:make_declared", 2)
    for attribute in ("declared", "with_parameters", "dt"):
        assert not hasattr(bare, attribute), attribute
    assert set(declared.declared) == {"motor_force", "motor_damping", "grip", "full_lock"}
    with pytest.raises(ValueError, match="takes no parameters"):
        make_engine(f"{FILE}:make", 2, parameters={"grip": 0.5})


def test_declared_parameters_are_taken_one_set_for_each_row():
    declared = make_engine(f"{FILE}:make_declared", 2)
    engine = declared.with_parameters(TensorDict({"motor_force": torch.tensor([6.0, 12.0])}, [2]))
    check_env_specs(engine)
    assert engine.rollout(2)[keys.POSE].dtype == torch.float32
    state = engine.reset()
    for _ in range(30):
        state = engine.step(state.set(keys.ACTION, torch.tensor([[1.0, 0.0]] * 2)))["next"]
    slow, fast = state[keys.VELOCITY][:, 0]
    assert slow < 0.7 * fast
    same = make_engine(f"{FILE}:make_declared", 2, parameters={"motor_force": 6.0})
    assert isinstance(same, EnvBase)


@pytest.mark.parametrize("effect", EFFECTS)
def test_every_effect_stands_over_it(effect):
    def size(p):
        return torch.full((3,), p.value + 0.2 * (min(p.upper, p.value + 1.0) - p.value))

    values = {p.name: size(p) for p in effect_class(effect).declared}
    missing = make_effect(effect).with_parameters(TensorDict(values, [3]))
    env = with_effects(make_engine(f"{FILE}:make_quick", 3), [missing])
    check_env_specs(env)
    assert env.rollout(1)["next", keys.POSE].dtype == torch.float32


def several(folder):
    """A simulator file with effects of every kind, some with a memory."""
    file = folder / "repaired.yaml"
    file.write_text(
        f"engine: {plain_env.__file__}:make_declared\n"
        "parameters: {grip: 0.7}\n"
        "effects:\n"
        "  battery_sag: {loss_per_minute: 0.1}\n"
        "  throttle_lag: {time_constant: 0.05}\n"
        "  steering_dead_time: {dead_time: 0.05}\n"
        "  tire_grip: {grip: 0.9}\n"
        "  aerodynamic_drag: {coefficient: 0.05}\n"
        "  sensor_latency: {dead_time: 0.03}\n"
        "  sensor_yaw: {angle: 0.05}\n"
    )
    return str(file)


@pytest.mark.parametrize("simulator", ["plain", "with effects"])
def test_a_shipped_task_stands_over_it(simulator, tmp_path):
    source = f"{FILE}:make" if simulator == "plain" else several(tmp_path)
    env = make_env(source, task=task(), batch_size=4)
    check_env_specs(env)
    env.set_seed(0)
    rows = env.rollout(10)
    assert rows["observation"].dtype == rows["next", keys.REWARD].dtype == torch.float32
    assert rows["next", "observation"].isfinite().all()


def test_an_environment_object_is_as_good_as_its_name():
    given = make_env(plain_env.make(4), task=task())
    named = make_env(f"{FILE}:make", task=task(), batch_size=4)
    assert given.observation_spec == named.observation_spec
    assert given.rollout(2)[keys.POSE].dtype == torch.float32
    lag = make_effect("steering_lag", {"time_constant": 0.1})
    assert with_effects(plain_env.make(4), [lag]).rollout(2)[keys.POSE].dtype == torch.float32


def test_a_controller_drives_it_round_a_path(tmp_path):
    for source in (f"{FILE}:make_quick", several(tmp_path)):
        stack = task("transforms.waypoints.options.order=fixed", "paths.kind=circle")
        env = make_env(make_simulator(source, 2), task=stack)
        scores = drive(env, PurePursuit(), 70)
        assert (scores.waypoints > 1).all(), source
        assert (scores.kept_on == 1).all(), source


def test_a_policy_learns_in_it_and_goes_on_from_a_checkpoint():
    settings = PPOConfig(cars=4, batch_steps=8, minibatch=16, epochs=1, steps=96)

    def run():
        env = make_env(f"{FILE}:make", task=task(), batch_size=4)
        return PPO(env, Policy(23, PolicyConfig(hidden=[8])), settings)

    torch.manual_seed(0)
    whole = run()
    batches = whole.run()
    next(batches)
    state = whole.state_dict()
    state = {**state, "policy": {k: v.clone() for k, v in state["policy"].items()}}
    rewards = [metrics["reward"] for metrics in batches]
    assert len(rewards) == 2
    assert all(map(torch.isfinite, map(torch.tensor, rewards)))
    assert state["cars"]["servo.angle"].dtype == torch.float64
    resumed = run()
    resumed.load_state_dict(state)
    assert resumed.collector.state["servo", "angle"].dtype == torch.float64
    assert next(resumed.run())["reward"] == rewards[0]
