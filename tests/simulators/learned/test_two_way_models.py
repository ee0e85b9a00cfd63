"""Models of cars with brakes and reverse."""

from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.core.longitudinal import LongitudinalCommand
from buggy_rl.recordings import Recording
from buggy_rl.simulators import make_engine
from buggy_rl.simulators.learned.base import NO_DRIVE, one_way_throttle
from buggy_rl.simulators.learned.factory import ModelConfig, load_model, make_model, save_model
from buggy_rl.simulators.learned.normalisation import coasting_deceleration, resting_throttle
from buggy_rl.simulators.learned.training import Training, TrainingConfig

ESC = LongitudinalCommand("throttle_brake_reverse")
CONFIG = ModelConfig("mlp", options={"rows": 2, "hidden": [32]})


def drives(seeds, seconds=24):
    """Cars whose commands are drawn anew every 0.8 s, from full reverse to half throttle."""
    engine = make_engine("kinematic", len(seeds), command=ESC)
    generators = [torch.Generator().manual_seed(seed) for seed in seeds]
    state, rows = engine.reset(), []
    for step in range(100 * seconds):
        if step % 80 == 0:
            draw = torch.stack([torch.rand(2, generator=generator) for generator in generators])
            throttle = (1.5 * draw[:, 0] - 1.0) * float(step % 240 > 0)
            command = torch.stack([throttle, draw[:, 1] - 0.5], -1)
        state[keys.ACTION] = command.clone()
        rows.append(state.select(keys.POSE, keys.VELOCITY, keys.ACTION).clone())
        state = engine.step(state)["next"].exclude(keys.REWARD)
    made = []
    for car, seed in enumerate(seeds):
        data = TensorDict(torch.stack(rows)[:, car].to_dict(), [len(rows)])
        data[keys.TIME] = 0.01 * torch.arange(len(rows), dtype=torch.float64)[:, None]
        data[keys.SEGMENT] = torch.zeros(len(rows), dtype=torch.int64)
        made.append(Recording(f"drive_{seed}", data, 0.01, command=ESC))
    return made


@pytest.fixture(scope="module")
def recorded():
    return drives([1, 2, 3, 4])


@pytest.fixture(scope="module")
def trained(recorded):
    torch.manual_seed(0)
    quick = TrainingConfig(epochs=12, horizon=10, stride=5, batch_size=64, learning_rate=3e-3)
    training = Training(make_model(CONFIG), recorded[:2], recorded[2:3], quick)
    for _ in training.run():
        pass
    return training.model.eval()


def held(model, throttle, vx, steps=60):
    """Velocity [3] after a throttle was held."""
    engine = make_engine("learned", 1, model=model)
    velocity = torch.tensor([[vx, 0.0, 0.0]])
    state = engine.reset(TensorDict({keys.VELOCITY: velocity}, [1]), set_state=True)
    for _ in range(steps):
        state[keys.ACTION] = torch.tensor([[throttle, 0.0]])
        state = engine.step(state)["next"].exclude(keys.REWARD)
    return state[keys.VELOCITY][0]


def test_a_throttle_is_asked_of_both_ways_alike():
    throttle = torch.tensor([-1.0, -0.01, 0.0, 0.5])
    assert one_way_throttle(throttle, 0.0).tolist() == pytest.approx([0.0, -0.99, -1.0, -0.5])
    assert torch.equal(one_way_throttle(throttle, -1.0), throttle)


@pytest.mark.slow
def test_a_model_of_recordings_with_reverse_stands_brakes_and_reverses(trained):
    assert trained.command == ESC
    assert torch.equal(held(trained, 0.0, 0.03), torch.zeros(3))
    assert held(trained, 0.4, 0.0)[0] > 0.3
    assert held(trained, -0.9, 0.0)[0] < -0.2
    braked, coasted = held(trained, -0.7, 1.5, 25)[0], held(trained, 0.0, 1.5, 25)[0]
    assert braked < coasted - 0.2


@pytest.mark.slow
def test_a_car_that_coasts_backward_loses_speed(trained):
    speeds = [float(held(trained, 0.0, -0.6, steps)[0].abs()) for steps in (1, 20, 40)]
    assert speeds == sorted(speeds, reverse=True)


@pytest.mark.slow
def test_its_engine_is_at_rest_at_0_and_says_what_it_takes(trained):
    engine = make_engine("learned", 2, model=trained)
    assert engine.command == ESC
    assert engine.reset()[keys.HISTORY][..., 3].abs().max() == 0.0


@pytest.mark.slow
def test_what_it_takes_is_saved_with_it(trained, tmp_path):
    save_model(trained, CONFIG, tmp_path / "two.pt", {"dt": 0.01})
    assert load_model(tmp_path / "two.pt")[0].command == ESC
    save_model(make_model(CONFIG), CONFIG, tmp_path / "one.pt", {"dt": 0.01})
    assert not load_model(tmp_path / "one.pt")[0].command.two_way
    assert "command" not in torch.load(tmp_path / "one.pt", weights_only=True)


def test_resting_and_coasting_are_judged_by_both_ways(recorded):
    # Never standing under a command: without one only. Half the mass's friction: over 0.3 m/s^2.
    recordings = recorded[3:]
    assert NO_DRIVE <= resting_throttle(recordings) < -0.85
    assert coasting_deceleration(recordings) > 0.3


def test_one_kind_of_command_is_learned_at_a_time():
    five, six, seven = drives([5, 6, 7], 4)
    other = replace(five, command=LongitudinalCommand("current"))
    with pytest.raises(ValueError, match="drive_5 current: a model learns one kind"):
        Training(make_model(CONFIG), [six, other], [seven], TrainingConfig())
