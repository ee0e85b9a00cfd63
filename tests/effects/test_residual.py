import math

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import check_env_specs

from buggy_rl.core import keys
from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.effects import EFFECTS, make_effect, make_effects
from buggy_rl.effects.motion.base import Motion
from buggy_rl.effects.residual import ResidualAcceleration, lagged_commands, residual_inputs
from buggy_rl.effects.residual_models import (
    INPUTS,
    LAGS,
    REACH,
    ResidualNetwork,
    ResidualProcess,
    ResidualSum,
    load_residual,
)
from tests.effects.faults import over, start, step

ARM = VehicleDimensions().sensor_to_cg
ACCELERATION = (1.0, 0.5, 1.5)


def constant():
    """A network that answers (1, 0.5, 1.5) whatever it sees: half of its bound (2, 1, 3)."""
    network = ResidualNetwork()
    for parameter in network.parameters():
        torch.nn.init.zeros_(parameter)
    torch.nn.init.constant_(network.layers[-1].bias, math.atanh(0.5))
    network.bound.copy_(torch.tensor([2.0, 1.0, 3.0]))
    return network.requires_grad_(False)


def random(seed=0):
    torch.manual_seed(seed)
    return ResidualNetwork().requires_grad_(False)


def test_velocity_changes_by_the_acceleration_at_the_centre_of_gravity():
    env = over([ResidualAcceleration(model=constant(), strength=1.0)])
    got = step(env, start(env))[keys.VELOCITY]
    # In 10 ms the centre of gravity gains (0.01, 0.005) m/s and 0.015 rad/s. The sensor sits
    # `sensor_to_cg` from it along x: it gains that much times the yaw rate across.
    expected = torch.tensor([0.01, 0.005 + 0.015 * ARM, 0.015])
    torch.testing.assert_close(got, expected, atol=1e-6, rtol=0)


def test_half_the_strength_is_half_the_change():
    one, half = (over([ResidualAcceleration(model=constant(), strength=s)]) for s in (1.0, 0.5))
    changed = step(one, start(one))[keys.VELOCITY]
    torch.testing.assert_close(step(half, start(half))[keys.VELOCITY], 0.5 * changed)


def test_cars_at_strength_zero_are_not_touched():
    effect = ResidualAcceleration(model=random()).with_parameters(
        TensorDict({"strength": torch.tensor([0.0, 1.0])}, [2])
    )
    env, bare = over([effect], "single_track", (2,)), over([], "single_track", (2,))
    moving = (1.5, 0.1, 1.0)
    got, free = (step(e, start(e, moving), (0.5, 0.3)) for e in (env, bare))
    assert torch.equal(got[keys.VELOCITY][0], free[keys.VELOCITY][0])
    assert torch.equal(got[keys.POSE][0], free[keys.POSE][0])
    assert not torch.equal(got[keys.VELOCITY][1], free[keys.VELOCITY][1])


def test_the_network_sees_velocity_command_and_the_engines_own_acceleration():
    # From 2 to 2.1 m/s in 10 ms, and from 0 to 0.2 rad/s: 10 m/s^2 and 20 rad/s^2. The frame turns
    # by half a milliradian each way, which shows in the fourth digit of the lateral part only.
    motion = Motion(
        pose=torch.zeros(1, 3),
        before=torch.tensor([[2.0, 0.0, 0.0]]),
        after=torch.tensor([[2.1, 0.0, 0.2]]),
        action=torch.tensor([[0.4, -0.6]]),
        dt=0.01,
    )
    # Across: 0.0005 * (2 + 2.1) / 0.01 = 0.205 m/s^2.
    expected = torch.tensor([[2.0, 0.0, 0.0, 0.4, -0.6, 10.0, 0.205, 20.0]])
    torch.testing.assert_close(residual_inputs(motion), expected, atol=1e-3, rtol=0)


def ranged(low=-2.0, high=2.0):
    """A network that has seen inputs within a range, two deviations to either side."""
    network = random()
    network.low.fill_(low)
    network.high.fill_(high)
    return network


def test_within_what_was_driven_the_range_changes_nothing():
    inputs = 4.0 * torch.rand(50, 8) - 2.0
    assert torch.equal(ranged()(inputs), random()(inputs))


def test_far_from_what_was_driven_it_is_silent():
    inputs = torch.zeros(4, 8)
    inputs[:, 0] = torch.tensor([2.0, 3.0, 4.0, 7.0])  # so many deviations beyond: 0, 1, 2, 5
    own = random()(inputs)
    share = torch.exp(-0.5 * torch.tensor([0.0, 1.0, 4.0, 25.0])).unsqueeze(-1)
    torch.testing.assert_close(ranged()(inputs), share * own)


def test_without_a_range_it_goes_on_as_at_the_edge():
    network = random()
    edge = network.mean + REACH * network.scale
    assert torch.equal(network(edge + 100.0), network(edge))


def test_a_file_without_a_range_is_read(tmp_path):
    file, network = tmp_path / "correction.pt", random()
    content = network.content
    content["weights"] = {k: v for k, v in content["weights"].items() if k not in ("low", "high")}
    torch.save(content, file)
    inputs = torch.randn(20, 8)
    assert torch.equal(load_residual(file)(inputs), network(inputs))


def test_a_command_beyond_its_bounds_is_seen_as_the_bound():
    effect = ResidualAcceleration(model=random(), strength=1.0, dt=0.01)
    env = over([effect], batch_size=(2,))
    state = start(env, (1.0, 0.0, 0.0))
    state[keys.ACTION] = torch.tensor([[1.0, 1.0], [1.7, 1.7]])
    first, second = env.step(state)["next", keys.VELOCITY]
    assert torch.equal(first, second)


def test_no_acceleration_exceeds_its_bound():
    network = random()
    for parameter in network.parameters():
        parameter.mul_(100.0)
    network.bound.copy_(torch.tensor([2.0, 1.0, 3.0]))
    assert (network(10 * torch.randn(500, 8)).abs() <= network.bound).all()


def test_a_saved_network_is_read_as_it_was(tmp_path):
    file, network = tmp_path / "correction.pt", random()
    network.mean.fill_(0.3)
    network.save(file)
    (effect,) = make_effects({"residual_acceleration": {"model": str(file), "strength": 1.0}})
    inputs = torch.randn(20, 8)
    assert torch.equal(effect.network(inputs), network(inputs))
    assert effect.options == {"model": str(file)}


def test_a_missing_or_foreign_file_is_refused(tmp_path):
    with pytest.raises(ValueError, match="there is no correction"):
        make_effect("residual_acceleration", model=str(tmp_path / "none.pt"))
    torch.save({"weights": {}}, tmp_path / "other.pt")
    with pytest.raises(ValueError, match="is no correction"):
        make_effect("residual_acceleration", model=str(tmp_path / "other.pt"))


def test_it_stands_next_to_the_engine_and_is_no_cause_to_choose(tmp_path):
    file = tmp_path / "correction.pt"
    random().save(file)
    stack = make_effects({"battery_sag": {}, "residual_acceleration": {"model": str(file)}})
    assert [effect.name for effect in stack] == ["residual_acceleration", "battery_sag"]
    assert "residual_acceleration" not in EFFECTS


def test_it_is_a_sound_environment():
    check_env_specs(over([ResidualAcceleration(model=random(), strength=1.0)], "single_track", 3))


def test_networks_one_upon_the_other_are_as_effects_one_after_the_other(tmp_path):
    first, second = random(1), random(2)
    file = tmp_path / "both.pt"
    ResidualSum([(0.5, first), (1.0, second)]).save(file)
    both = load_residual(file)
    apart = [
        ResidualAcceleration(model=first, strength=0.5),
        ResidualAcceleration(model=second, strength=1.0),
    ]
    one = over([ResidualAcceleration(model=str(file), strength=1.0)], "single_track", (4,))
    two = over(apart, "single_track", (4,))
    moving = (2.0, 0.1, 1.0)
    # To the second order of a step: the second network sees the first one's change of the frame.
    for key in (keys.POSE, keys.VELOCITY):
        a, b = (step(env, start(env, moving), (0.5, 0.3))[key] for env in (one, two))
        torch.testing.assert_close(a, b, atol=1e-4, rtol=0)
    assert isinstance(both, ResidualSum)
    assert both.strengths == [0.5, 1.0]


def process(seed=0):
    model, random = ResidualProcess(), torch.Generator().manual_seed(seed)
    model.weights.copy_(0.3 * torch.randn(model.weights.shape, generator=random))
    return model


def test_a_process_is_a_sound_environment_that_remembers_commands():
    effect = ResidualAcceleration(model=process(), strength=1.0)
    env = over([effect], "single_track", 3)
    check_env_specs(env)
    assert effect.memory in env.reset().keys()  # noqa: SIM118  TensorDict has no `in`


def test_lagged_commands_follow_with_their_time_constants():
    dt, now = 0.001, torch.tensor([[1.0, -0.5]])
    past, known = torch.zeros(1, 4), torch.ones(1, 1, dtype=torch.bool)
    for _ in range(round(LAGS[0] / dt)):
        past = lagged_commands(past, now, known, dt)
    share = [1 - math.exp(-LAGS[0] / lag) for lag in LAGS]
    expected = torch.tensor([[share[0], -0.5 * share[0], share[1], -0.5 * share[1]]])
    torch.testing.assert_close(past, expected, atol=2e-3, rtol=0)


def test_a_command_before_the_first_is_taken_to_be_the_first():
    now = torch.tensor([[0.7, -0.2]])
    past = lagged_commands(torch.zeros(1, 4), now, torch.zeros(1, 1, dtype=torch.bool), 0.01)
    torch.testing.assert_close(past, torch.cat([now, now], -1))


def test_features_have_the_kernel_of_their_length():
    model = ResidualProcess(4096)
    a = 0.3 * torch.randn(1, INPUTS, generator=torch.Generator().manual_seed(3))
    b = a + 0.4
    cosines = model.features(torch.cat([a, b]))[:, : model.count]
    distance = float((a - b).norm())
    expected = math.exp(-(distance**2) / (2 * model.LENGTH**2))
    assert float(cosines[0] @ cosines[1]) == pytest.approx(expected, abs=0.05)
    assert float(cosines[0] @ cosines[0]) == pytest.approx(1.0, abs=0.05)


def test_no_acceleration_of_a_process_exceeds_its_bound():
    model = process()
    model.weights.mul_(100.0)
    model.bound.copy_(torch.tensor([2.0, 1.0, 3.0]))
    assert (model(10 * torch.randn(500, INPUTS)).abs() <= model.bound).all()


def test_a_process_upon_a_network_is_read_as_it_was(tmp_path):
    file, network, upon = tmp_path / "both.pt", random(), process()
    both = ResidualSum([(0.5, network), (1.0, upon)])
    both.save(file)
    inputs = torch.randn(20, INPUTS)
    first = 0.5 * network(inputs)
    seen = torch.cat([inputs[:, :5], inputs[:, 5:8] + first, inputs[:, 8:]], -1)
    torch.testing.assert_close(load_residual(file)(inputs), first + upon(seen))
