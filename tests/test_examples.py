"""The simulators in examples/, made by adapters of the package, are what contract 2 asks for."""

import copy
import pickle
import re
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import check_env_specs

from buggy_rl.core import keys
from buggy_rl.core.config import load_named
from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.diagnosis.pipeline import run_diagnosis
from buggy_rl.diagnosis.preflight.simulator import check_simulator
from buggy_rl.effects import make_effect
from buggy_rl.effects.measuring import measurable_options
from buggy_rl.simulators import make_engine
from buggy_rl.task.env import make_simulator, with_effects
from tests.diagnosis.planted import planted_drives

EXAMPLES = ("step_car", "gym_car", "mjcf_car")
PAGE = (Path(__file__).parents[1] / "docs" / "simulators.md").read_text()


@pytest.fixture(params=EXAMPLES)
def factory(request, repository):
    return load_named(f"{repository}/examples/{request.param}.py:make")


def rolling(engine, speed=1.5):
    """Cars at this speed, straight ahead."""
    shape = (*engine.batch_size, 3)
    start = TensorDict({keys.POSE: torch.zeros(shape)}, engine.batch_size)
    start[keys.VELOCITY] = torch.tensor([speed, 0.0, 0.0]).expand(shape).clone()
    return engine.reset(start, set_state=True)


def driven(engine, state, throttle, steering, rows):
    action = torch.tensor([throttle, steering]).expand(*engine.batch_size, 2)
    for _ in range(rows):
        state = engine.step(state.set(keys.ACTION, action.clone()))["next"]
    return state


@pytest.mark.parametrize("batch_size", [(), (3,)], ids=["one", "three"])
def test_an_example_is_an_engine(factory, batch_size):
    engine = make_engine(factory, batch_size)
    check_env_specs(engine)
    assert engine.batch_locked
    assert engine.rollout(3)[keys.POSE].dtype == torch.float32


@pytest.mark.slow
def test_an_example_passes_what_a_diagnosis_asks_first(factory):
    notes = check_simulator(lambda count: make_engine(factory, count), "the example")
    assert all("one environment" in note for note in notes), notes
    options, _ = measurable_options(lambda count: make_simulator(factory, count))
    assert options["throttle_gain"], "the drive of the example was not measured"


def test_an_example_goes_ahead_and_to_the_left(factory):
    engine = make_engine(factory, 2)
    state = driven(engine, rolling(engine, 0.0), 0.2, 0.0, 100)
    x, y, _ = state[keys.POSE][0].tolist()
    assert x > 0.3
    assert abs(y) < 0.02
    state = driven(engine, rolling(engine), -0.2, 0.6, 50)
    assert (state[keys.VELOCITY][:, 2] > 0.5).all()
    # Wheels of a car that is set down at speed roll: it goes on.
    coasted = driven(engine, rolling(engine), -1.0, 0.0, 10)[keys.VELOCITY][:, 0]
    assert (coasted > 1.2).all()
    assert (coasted < 1.5).all()


def test_two_steps_are_equal_after_others_and_edits_are_honoured(factory):
    engine = make_engine(factory, 2)
    state = driven(engine, rolling(engine), 0.1, 0.3, 5)
    state[keys.ACTION] = torch.tensor([[0.3, -0.4], [0.0, 0.2]])
    first = engine.step(state.clone())["next"]
    driven(engine, rolling(engine, 0.5), 0.8, -1.0, 4)
    again = engine.step(state.clone())["next"]
    for key, value in first.items():
        assert torch.equal(value, again[key]), key
    edited = state.clone()
    edited[keys.POSE] = edited[keys.POSE] + torch.tensor([2.0, -1.0, 0.0])
    moved = engine.step(edited)["next"][keys.POSE] - first[keys.POSE]
    torch.testing.assert_close(moved, torch.tensor([[2.0, -1.0, 0.0]] * 2), atol=1e-4, rtol=0)


@pytest.mark.parametrize("example", EXAMPLES)
@pytest.mark.parametrize(
    "copied", [copy.deepcopy, lambda engine: pickle.loads(pickle.dumps(engine))]
)
def test_a_copy_of_an_example_drives_to_the_same_bits(example, copied, repository, monkeypatch):
    monkeypatch.syspath_prepend(str(repository))
    engine = make_engine(f"examples.{example}:make", 2)
    start = driven(engine, rolling(engine), 0.1, 0.3, 5)
    one, other = (driven(car, start, 0.3, -0.4, 5) for car in (engine, copied(engine)))
    assert all(torch.equal(one[key], value) for key, value in other.items())


def test_an_effect_stands_over_an_example(factory):
    late = make_effect("steering_dead_time", {"dead_time": 0.05})
    env = with_effects(make_engine(factory, 2), [late])
    check_env_specs(env)


def test_a_factory_reaches_another_process(repository, monkeypatch):
    monkeypatch.syspath_prepend(str(repository))
    for example in EXAMPLES:
        make = load_named(f"examples.{example}:make")
        engine = pickle.loads(pickle.dumps(make))(2, "cpu")
        assert engine.batch_size == torch.Size([2])


@pytest.mark.slow
def test_a_diagnosis_takes_an_example_as_an_object(repository):
    factory = load_named(f"{repository}/examples/step_car.py:make")
    weak = [{"throttle_gain": {"gain": 0.7}}]
    [recordings] = planted_drives(weak, make=lambda cars: make_engine(factory, cars))
    config = DiagnosisConfig(
        simulator=factory,
        recordings=["made in the test"],
        output="nowhere",
        effects=["throttle_gain", "steering_dead_time"],
        parameters=False,
        stretches=8,
        minutes=0.0,
        workers=1,
    )
    [effect] = run_diagnosis(config, recordings).answer.effects
    assert effect.name == "throttle_gain"
    assert effect.parameters["gain"].value == pytest.approx(0.7, abs=0.05)


def test_the_page_names_every_example_and_its_code_runs(capsys):
    assert set(re.findall(r"\(../examples/(\w+)\.py\)", PAGE)) == set(EXAMPLES)
    section = PAGE.split("\n## Your own simulator\n")[1].split("\n## ")[0]
    [block] = re.findall(r"^```python\n(.*?)^```", section, re.M | re.S)
    exec(block, {})
    assert "[4, 10, 3]" in capsys.readouterr().out
