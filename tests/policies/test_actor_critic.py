import math

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from buggy_rl.policies.training.actor_critic import (
    Policy,
    PolicyConfig,
    Scaling,
    load_policy,
    save_policy,
)

SIZE = 23


def seen(rows=64, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return 3.0 * torch.randn(rows, SIZE, generator=generator) + torch.arange(SIZE)


def drawn(policy, observation):
    with set_exploration_type(ExplorationType.RANDOM):
        return policy.actor()(TensorDict({"observation": observation}, observation.shape[:-1]))


def test_scaling_in_parts_is_scaling_of_the_whole():
    whole, parts = Scaling(SIZE), Scaling(SIZE)
    rows = seen(300)
    whole.update(rows)
    for part in rows.split([7, 100, 193]):
        parts.update(part.reshape(1, -1, SIZE))  # any batch shape
    torch.testing.assert_close(whole.mean, rows.mean(0))
    torch.testing.assert_close(whole.sd, rows.std(0, correction=0))
    torch.testing.assert_close(parts.mean, whole.mean)
    torch.testing.assert_close(parts.sd, whole.sd)
    assert parts.count == 300


def test_a_number_that_never_changes_is_not_blown_up():
    scaling = Scaling(2)
    scaling.update(torch.tensor([[1.0, 4.0], [3.0, 4.0]]))
    # mean (2, 4), sd (1, 0 -> 0.01)
    scaled = scaling(torch.tensor([[3.0, 4.02]]))
    torch.testing.assert_close(scaled, torch.tensor([[1.0, 2.0]]), atol=1e-3, rtol=0)


def test_likelihood_is_that_of_two_independent_normals():
    policy = Policy(SIZE, PolicyConfig(initial_sd=0.5))
    td = drawn(policy, seen())
    z = (td["action"] - td["loc"]) / 0.5
    expected = (-0.5 * z.square() - math.log(0.5 * math.sqrt(2 * math.pi))).sum(-1)
    torch.testing.assert_close(td["action_log_prob"], expected)


def test_exploration_is_the_same_in_every_state_and_not_cut_off():
    policy = Policy(SIZE, PolicyConfig(initial_sd=2.0))
    td = drawn(policy, seen(500))
    assert (td["scale"] == 2.0).all()
    assert td["action"].abs().max() > 3.0


def test_the_driver_is_the_actor_without_exploration():
    policy, observation = Policy(SIZE), seen()
    policy.observe(observation)
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        mean = policy.actor()(TensorDict({"observation": observation}, [64]))["action"]
    driven = policy.driver()(TensorDict({"observation": observation}, [64]))["action"]
    assert torch.equal(driven, mean)
    assert not torch.equal(driven, drawn(policy, observation)["action"])


def test_what_the_policy_has_seen_reaches_actor_critic_and_driver():
    policy, observation = Policy(SIZE), seen()
    parts = policy.actor(), policy.critic(), policy.driver()
    before = [part(TensorDict({"observation": observation}, [64])) for part in parts]
    policy.observe(observation)
    after = [part(TensorDict({"observation": observation}, [64])) for part in parts]
    for key, one, other in zip(("loc", "state_value", "action"), before, after, strict=True):
        assert not torch.allclose(one[key], other[key]), key


def test_without_scaling_observations_count_as_they_are():
    torch.manual_seed(0)
    policy, observation = Policy(SIZE, PolicyConfig(scaling="none")), seen()
    before = policy.driver()(TensorDict({"observation": observation}, [64]))["action"]
    policy.observe(observation)
    assert torch.equal(
        policy.driver()(TensorDict({"observation": observation}, [64]))["action"], before
    )


@pytest.mark.parametrize(
    "config", [PolicyConfig(), PolicyConfig(hidden=[32], activation="tanh", scaling="none")]
)
def test_a_saved_policy_drives_as_before(tmp_path, config):
    policy, observation = Policy(SIZE, config), seen()
    policy.observe(observation)
    save_policy(policy, tmp_path / "policy.pt", {"engine": "mujoco"})
    loaded, about = load_policy(tmp_path / "policy.pt")
    one, other = (
        p.driver()(TensorDict({"observation": observation}, [64])) for p in (policy, loaded)
    )
    assert torch.equal(one["action"], other["action"])
    assert loaded.config == config
    assert about == {"engine": "mujoco"}
    assert [file.name for file in tmp_path.iterdir()] == ["policy.pt"]  # nothing half-written


def test_a_file_that_is_no_policy_is_refused(tmp_path):
    with pytest.raises(ValueError, match="there is no policy file"):
        load_policy(tmp_path / "policy.pt")
    torch.save({"weights": {}}, tmp_path / "other.pt")
    with pytest.raises(ValueError, match=r"other\.pt was not written by"):
        load_policy(tmp_path / "other.pt")
