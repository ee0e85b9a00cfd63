"""Surrogate gradients: the simulator's values, the model's Jacobians."""

import pytest
import torch
import yaml
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.core.vehicle import integrate_pose
from buggy_rl.policies.training.actor_critic import Policy
from buggy_rl.policies.training.shac import SHAC, SHACConfig
from buggy_rl.simulators import make_engine
from buggy_rl.simulators.learned.factory import ModelConfig, make_model, save_model
from buggy_rl.simulators.surrogate import SurrogateEngine
from buggy_rl.task.env import make_env, make_simulator
from tests import plain_env
from tests.contracts.test_engines import manoeuvre, untrained_model
from tests.simulators.steps import follow, start

CARS = 3
MOVING = ((1.5, 0.1, 0.5), (2.0, -0.2, -1.0), (1.0, 0.0, 0.3))


@pytest.fixture(scope="module", autouse=True)
def gradients():
    """As usual."""


def surrogate(simulator="mujoco", **options):
    return SurrogateEngine(CARS, simulator=simulator, model=untrained_model(), **options)


def driven(engine, commands):
    """States [steps + 1] under commands [steps, cars, 2], with gradients of these."""
    state = start(engine, torch.tensor(MOVING))
    states = [state]
    for command in commands:
        state = engine.step(state.clone().set(keys.ACTION, command))["next"]
        states.append(state)
    return states


def commands(steps=4):
    torch.manual_seed(3)
    return (0.6 * torch.rand(steps, CARS, 2) - 0.3).requires_grad_()


@pytest.mark.parametrize("simulator", ["mujoco", "reference", "single_track", "hold"])
def test_values_are_those_of_the_simulator_to_the_last_bit(simulator):
    alone, carried = make_engine(simulator, CARS), surrogate(simulator)
    actions = (manoeuvre(40)[:, None] * torch.tensor([1.0, -1.0, 0.5])[:, None]).requires_grad_()
    with torch.no_grad():  # kernels, where there are some, run for both
        one, silent = driven(alone, actions), driven(carried, actions)
    for with_gradient in (silent, driven(carried, actions)):
        for before, after in zip(one, with_gradient, strict=True):
            for key in alone.state_spec:
                assert torch.equal(before[key], after[key].detach()), key


def test_the_gradient_is_that_of_the_model_along_the_drive_of_the_simulator():
    # d v_4 / d u by the chain of the model's own Jacobians, each a finite difference at the
    # velocities and commands of MuJoCo's drive.
    engine, model = surrogate(), untrained_model().double()
    given = commands()
    states = driven(engine, given)
    weights = torch.tensor([1.0, -2.0, 0.5])
    (found,) = torch.autograd.grad((states[-1][keys.VELOCITY] * weights).sum(), given)
    velocities = torch.stack([s[keys.VELOCITY].detach() for s in states]).double()
    actions = given.detach().double()
    past = states[0][keys.HISTORY].double()  # (cars, rows - 1, 5)

    def end(moved):
        """v_4, linear in what was moved, by Jacobians of the model at MuJoCo's drive."""
        change = [torch.zeros(CARS, 3).double()]
        for step in range(len(actions)):
            rows = torch.cat([velocities[: step + 1], actions[: step + 1]], -1).movedim(0, 1)
            turned = torch.cat([torch.stack(change), moved[: step + 1]], -1).movedim(0, 1)
            at = torch.cat([past, rows], 1)[:, -model.rows :]
            by = torch.cat([torch.zeros_like(past), turned], 1)[:, -model.rows :]
            h = 1e-5
            change.append((model(at + h * by) - model(at - h * by)) / (2 * h))
        return (change[-1] * weights).sum()

    for place in [(0, 0, 0), (0, 1, 1), (2, 2, 0), (3, 0, 1)]:
        moved = torch.zeros_like(actions)
        moved[place] = 1.0
        assert found[place].item() == pytest.approx(end(moved).item(), rel=1e-3, abs=1e-6)


def test_the_gradient_of_the_pose_is_that_of_its_integration_from_velocities():
    engine, given = surrogate(), commands(2)
    before, after = driven(engine, given)[1:]
    weights = torch.tensor([1.0, 3.0, -2.0])
    (found,) = torch.autograd.grad((after[keys.POSE] * weights).sum(), given, retain_graph=True)
    ends = (before[keys.POSE], before[keys.VELOCITY], after[keys.VELOCITY])
    moved = integrate_pose(*ends, engine.dt)
    (expected,) = torch.autograd.grad((moved * weights).sum(), given)
    assert found.abs().max() > 0
    torch.testing.assert_close(found, expected)


def test_no_gradient_passes_from_the_simulator_itself():
    # The single track has gradients of its own; here only the model's pass.
    given = commands(1)
    ends = [driven(surrogate(name), given)[-1][keys.VELOCITY] for name in ("single_track", "hold")]
    slopes = [torch.autograd.grad(end.sum(), given)[0] for end in ends]
    assert torch.equal(*slopes)
    assert slopes[0].abs().max() > 0


def test_without_gradients_the_model_is_not_evaluated(monkeypatch):
    engine = surrogate()
    monkeypatch.setattr(engine.learned.model, "forward", None)
    with torch.no_grad():
        follow(engine, start(engine, MOVING), manoeuvre(2))
    with pytest.raises(TypeError, match="NoneType"):
        follow(engine, start(engine, MOVING), manoeuvre(1))


def test_readings_and_history_are_those_of_the_learned_engine_at_the_simulators_drive():
    engine = surrogate()
    states = driven(engine, commands(3).detach())
    rows = torch.stack([states[2][keys.VELOCITY], states[1][keys.VELOCITY]], 1)
    history = states[-1][keys.HISTORY]  # (cars, rows - 1, 5), of a model of three rows
    assert torch.equal(history[..., :3], rows.flip(1))
    assert torch.equal(history[..., 3:], commands(3).detach()[1:].movedim(0, 1))
    fast = torch.tensor([[9.0, 0.0, 0.0]]).expand(CARS, 3)
    _, _, after = follow(engine, start(engine, fast), [(0.0, 0.0)])
    assert after[keys.OUT_OF_RANGE].all()
    # (9 - 3.5) / 4.5 widths beyond the range of vx.
    torch.testing.assert_close(after[keys.RANGE_EXCESS], torch.full((CARS, 1), 5.5 / 4.5))


def test_parameters_are_those_of_the_simulator_one_set_for_each_car():
    engine = surrogate(parameters={"mass": 2.0})
    assert engine.values["mass"].item() == 2.0
    drawn = TensorDict({"mass": torch.tensor([1.0, 2.0, 3.0])}, [CARS])
    moved = engine.with_parameters(drawn)
    assert torch.equal(moved.simulator.values["mass"], drawn["mass"])
    assert moved.vehicle().mass == 2.0
    alone = make_engine("mujoco", CARS).with_parameters(drawn)
    expected, found = (follow(each, start(each), manoeuvre(10))[0] for each in (alone, moved))
    assert torch.equal(found, expected)


@pytest.fixture
def files(tmp_path):
    (tmp_path / "models").mkdir()
    model = make_model(ModelConfig("mlp", options={"rows": 3}))
    save_model(model, ModelConfig("mlp", options={"rows": 3}), tmp_path / "models" / "m.pt", {})
    fitted = {"engine": "mujoco", "parameters": {"mass": 2.0}}
    (tmp_path / "fitted.yaml").write_text(yaml.safe_dump(fitted))
    return tmp_path


def test_a_simulator_file_names_both_beside_itself(files):
    options = {"simulator": "fitted.yaml", "model": "models/m.pt"}
    effects = {"steering_dead_time": {"dead_time": 0.05}}
    content = {"engine": "surrogate", "options": options, "effects": effects}
    (files / "surrogate.yaml").write_text(yaml.safe_dump(content))
    env = make_simulator(files / "surrogate.yaml", CARS)
    assert env.base_env.values["mass"].item() == 2.0
    named = make_simulator(
        "surrogate",
        CARS,
        simulator=str(files / "fitted.yaml"),
        model=str(files / "models" / "m.pt"),
    )
    assert isinstance(named, SurrogateEngine)
    assert named.values["mass"].item() == 2.0


def test_what_is_no_engine_and_a_model_of_another_command_are_refused():
    with pytest.raises(
        ValueError, match=r"make_quick is a .*, not an Engine: make one by from_step"
    ):
        surrogate(plain_env.make_quick)
    with pytest.raises(ValueError, match="takes the command 'current', the model was trained with"):
        surrogate("single_track", command="current")


def test_a_policy_is_trained_by_gradients_in_mujoco():
    engine = SurrogateEngine(8, simulator="mujoco", model=untrained_model())
    env = make_env(engine)
    torch.manual_seed(0)
    policy = Policy(env.observation_spec[keys.OBSERVATION].shape[-1])
    settings = SHACConfig(cars=8, steps=8 * 8, batch_steps=8, minibatch=64)
    (metrics,) = list(SHAC(env, policy, settings).run())
    assert metrics["gradient_norm"] > 0
