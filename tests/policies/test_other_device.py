"""Checkpoints of another device, as far as a machine without a GPU shows it."""

import warnings
from copy import deepcopy
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from tensordict import TensorDict

from buggy_rl.core.config import build
from buggy_rl.policies.training import run as run_module
from buggy_rl.policies.training.actor_critic import Policy
from buggy_rl.policies.training.checkpoint import (
    cars_state,
    restore_generator,
    restore_random,
    restored_cars,
)
from buggy_rl.policies.training.ppo import PPO
from buggy_rl.policies.training.run import PolicyRunConfig, policy_question
from tests.policies.test_ppo import CARS, Wind, config, curve, point

GPU_STATE = torch.arange(16, dtype=torch.uint8)  # of a CUDA generator; a CPU's has 5056 bytes


def training():
    torch.manual_seed(1)
    return PPO(point(Wind()), Policy(1), config())


class GpuGenerator:
    """A generator with the layout of CUDA's."""

    device = torch.device("cuda:0")

    def __init__(self):
        self.state, self.seed = GPU_STATE, None

    def get_state(self):
        return self.state

    def set_state(self, state):
        if state.shape != self.state.shape:
            raise RuntimeError("RNG state is wrong size")
        self.state = state

    def manual_seed(self, seed):
        self.seed = seed


def test_a_generator_of_the_same_kind_of_device_goes_on_with_the_same_numbers():
    one, other = torch.Generator().manual_seed(5), torch.Generator().manual_seed(6)
    torch.rand(7, generator=one)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        restore_generator(other, one.get_state(), "noise")
    assert torch.equal(torch.rand(3, generator=one), torch.rand(3, generator=other))


def test_a_generator_of_another_kind_is_seeded_by_the_state_and_says_so():
    here, seeds = torch.Generator(), []
    for state in (GPU_STATE, GPU_STATE, GPU_STATE + 1):
        with pytest.warns(UserWarning, match="another kind of device than cpu: noise goes on"):
            restore_generator(here, state, "noise")
        seeds.append(torch.rand(1, generator=here).item())
    assert seeds[0] == seeds[1] != seeds[2]
    there = GpuGenerator()
    with pytest.warns(UserWarning, match="another kind of device than cuda:0"):
        restore_generator(there, torch.Generator().get_state(), "noise")  # pyright: ignore
    assert there.seed is not None


def test_a_checkpoint_of_a_gpu_is_resumed_on_the_cpu():
    state = training().state_dict()
    state["random_device"] = GPU_STATE
    state["environment"]["generators"] = {
        name: GPU_STATE for name in state["environment"]["generators"]
    }
    assert state["environment"]["generators"]
    again = training()
    with pytest.warns(UserWarning, match="with other random numbers") as told:
        again.load_state_dict(state)
    assert len(told) == 2  # the environment's generator, and exploration
    assert len(list(again.run())) == 4


def test_exploration_of_the_cpu_goes_on_on_a_gpu_with_other_numbers(monkeypatch):
    gpu, set_states = torch.device("cuda:0"), []
    state = training().state_dict()
    assert state["random_device"] is None
    monkeypatch.setattr(torch.cuda, "set_rng_state", lambda *given: set_states.append(given))
    with pytest.warns(UserWarning, match="exploration goes on with other random numbers"):
        restore_random(gpu, state)
    assert set_states == []
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        restore_random(gpu, {**state, "random_device": GPU_STATE})
    ((restored, device),) = set_states
    assert (restored == GPU_STATE).all()
    assert device == torch.device("cuda:0")


def test_the_state_of_the_cars_goes_to_the_device_of_the_environment():
    cars = training().collector.state
    env: Any = SimpleNamespace(batch_size=torch.Size([CARS]), device=torch.device("meta"))
    moved = restored_cars(env, cars, cars_state(cars), [])
    assert isinstance(moved, TensorDict)
    assert {tensor.device.type for tensor in moved.values(True, True)} == {"meta"}


def test_the_state_of_the_optimiser_goes_to_the_device_of_the_weights():
    run = training()
    next(run.run())
    saved = run.optimiser.state_dict()
    there = [torch.nn.Parameter(w.detach().to("meta")) for w in run.weights]
    optimiser = torch.optim.Adam(there, 1e-3)
    optimiser.load_state_dict(saved)
    moments = [
        state[name] for state in optimiser.state.values() for name in ("exp_avg", "exp_avg_sq")
    ]
    assert {tensor.device.type for tensor in moments} == {"meta"}


def test_another_device_is_no_other_question_to_go_on_from():
    def asked(*more):
        given = build(PolicyRunConfig, ["output=x", "engine.simulator=kinematic", *more])
        return run_module._so_far(policy_question(given))

    assert asked("engine.options.device=cuda") == asked() == asked("engine.options.device=cpu")
    assert asked("engine.options.dt=0.02") != asked()


def test_on_the_same_device_nothing_is_said_and_the_curve_is_the_same():
    whole = training()
    batches = whole.run()
    next(batches)
    state = deepcopy(whole.state_dict())
    rest = curve(batches)
    again = training()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again.load_state_dict(state)
    assert curve(again.run()) == rest
