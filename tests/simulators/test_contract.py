"""A user's own simulator whose steps depend on more than their TensorDict is refused when made."""

import random

import numpy as np
import pytest
import torch

from buggy_rl.core import keys
from buggy_rl.simulators import make_engine
from buggy_rl.simulators.base import HoldEngine
from buggy_rl.simulators.contract import scatters
from tests import plain_env


class Counting(HoldEngine):
    """Constant velocity; `steps` are counted."""

    steps = 0

    def _advance(self, state, action):
        self.steps += 1
        return super()._advance(state, action)


class Changed(HoldEngine):
    """Constant velocity, and what a subclass does to it."""

    def _advance(self, state, action):
        result = super()._advance(state, action)
        change = self._change(state, action)
        return {**result, keys.VELOCITY: result[keys.VELOCITY] + change}


class Motor(Changed):
    """A motor that warms up with every step, outside of the TensorDict."""

    warmth = 0.0

    def _change(self, state, action):
        self.warmth += 0.002
        return self.warmth


class Delayed(Changed):
    """A dead time of three steps, in a list of its own."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.line = [torch.zeros(self._shape(2))] * 3

    def _change(self, state, action):
        self.line.append(action)
        return 0.01 * self.line.pop(0)[..., :1]


class Noisy(Changed):
    """Noise of PyTorch's generator."""

    def _change(self, state, action):
        return 0.01 * torch.randn(self._shape(3))


class NoisyByNumpy(Changed):
    def _change(self, state, action):
        return 0.01 * torch.as_tensor(np.random.normal(size=self._shape(3))).float()


class NoisyByItself(Changed):
    """Noise of a generator of its own, and a memory that is small beside it."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.generator, self.warmth = np.random.default_rng(0), 0.0

    def _change(self, state, action):
        self.warmth += 1e-4
        noise = torch.as_tensor(self.generator.normal(size=self._shape(3))).float()
        return self.warmth + 0.01 * noise


class DeafToVelocity(HoldEngine):
    """Moves at 1.5 m/s, whatever velocity it is given."""

    def _advance(self, state, action):
        fixed = torch.tensor([1.5, 0.0, 0.0]).expand(self._shape(3))
        return super()._advance(state.clone().set(keys.VELOCITY, fixed), action)


class DeafToHeading(HoldEngine):
    """Its yaw is 0, whatever pose it is given."""

    def _advance(self, state, action):
        level = state[keys.POSE] * torch.tensor([1.0, 1.0, 0.0])
        return super()._advance(state.clone().set(keys.POSE, level), action)


class Towing(Changed):
    """Every environment is pulled by the mean of all."""

    def _change(self, state, action):
        velocity = state[keys.VELOCITY].reshape(-1, 3)
        return 0.01 * (velocity.mean(0) - velocity).view(self._shape(3))


class Shouting(Changed):
    """Every environment obeys the command of the first, too."""

    def _change(self, state, action):
        return 0.01 * action.reshape(-1, 2)[0, 1]


MEMORY = "two steps from one TensorDict differ in 'velocity' by .*: it remembers what is not in"
NOISE = "two steps from one TensorDict differ in 'velocity' by 0.*: it is stochastic, it draws"
MIXED = "another pose, velocity or command of one environment moved the others by"
REFUSED = {
    Motor: MEMORY,
    Delayed: MEMORY,
    Noisy: NOISE,
    NoisyByNumpy: NOISE,
    NoisyByItself: NOISE,
    DeafToVelocity: "does not honour an edited velocity: 1 more was 0 more after one step; begin",
    DeafToHeading: "does not honour an edited pose: 0.5 more was 0 more after one step; begin each",
    Towing: f"{MIXED} 0.00",  # 0.01 (1 m/s) / 4 at most
    Shouting: f"{MIXED} 0.00",  # 0.01 of half a lock
}


@pytest.mark.parametrize("kind", REFUSED, ids=lambda kind: kind.__name__)
def test_what_breaks_the_contract_is_refused_by_name_with_how_much_and_what_to_do(kind):
    torch.manual_seed(0)
    with pytest.raises(ValueError, match=f"^simulator {kind.__name__}:? {REFUSED[kind]}") as told:
        make_engine(lambda_of(kind), 4)
    assert "docs/extending.md" in str(told.value)
    assert "\n" not in str(told.value)


def lambda_of(kind):
    def factory(batch_size, device):
        return kind(batch_size, device)

    factory.__qualname__ = kind.__name__
    return factory


ALONE = [kind for kind in REFUSED if kind not in (Towing, Shouting)]


@pytest.mark.parametrize("batch_size", [(), 1, (2, 3)], ids=str)
@pytest.mark.parametrize("kind", ALONE, ids=lambda kind: kind.__name__)
def test_it_is_refused_at_every_batch_size(kind, batch_size):
    with pytest.raises(ValueError, match=f"^simulator {kind.__name__}"):
        make_engine(lambda_of(kind), batch_size)


@pytest.mark.parametrize("batch_size", [(), 1, 4, (2, 3)], ids=str)
@pytest.mark.parametrize("factory", [plain_env.make_quick, HoldEngine])
def test_what_keeps_the_contract_is_made(factory, batch_size):
    assert make_engine(factory, batch_size).rollout(2)[keys.POSE].isfinite().all()


def test_one_instance_that_is_stepped_for_each_environment_in_turn_keeps_no_state_either():
    with pytest.raises(ValueError, match=MEMORY):
        make_engine(lambda batch_size, device: Motor((), device), 4)
    assert make_engine(lambda batch_size, device: HoldEngine((), device), 4).batch_size == (4,)


def test_a_simulator_is_stepped_a_handful_of_times():
    assert 5 <= make_engine(Counting, 2).steps <= 10


def test_no_random_state_is_changed():
    def drawn():
        return torch.rand(1).item(), np.random.rand(), random.random()

    torch.manual_seed(3), np.random.seed(3), random.seed(3)
    expected = drawn()
    torch.manual_seed(3), np.random.seed(3), random.seed(3)
    for kind in (Noisy, NoisyByNumpy):
        with pytest.raises(ValueError, match="stochastic"):
            make_engine(kind, 2)
    make_engine(HoldEngine, 2)
    assert drawn() == expected


def test_noise_scatters_and_a_memory_goes_on():
    generator = torch.Generator().manual_seed(0)
    ramp = torch.arange(13.0).unsqueeze(-1).expand(13, 3)
    noise = torch.randn(13, 3, generator=generator)
    assert scatters(list(noise))
    assert scatters(list(noise + 0.1 * ramp))
    assert not scatters(list(ramp))
    assert not scatters(list(1 - 0.5**ramp))  # settles
    assert not scatters(list(ramp + 0.1 * noise))


def test_the_packages_own_engines_are_not_stepped_when_they_are_made(monkeypatch):
    def refuse(*_):
        raise AssertionError("stepped")

    monkeypatch.setattr(HoldEngine, "_advance", refuse)
    assert make_engine("hold", 2).batch_size == (2,)
    with pytest.raises(ValueError, match="a step raised AssertionError: stepped"):
        make_engine(HoldEngine, 2)
