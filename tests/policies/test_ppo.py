"""PPO on a task small enough to follow by hand: a point on a line, pushed by the first command."""

import ast
import inspect
import math
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import CatFrames, Compose, EnvBase, StepCounter, Transform, TransformedEnv

from buggy_rl.core.config import build
from buggy_rl.core.files import save_torch
from buggy_rl.policies.training.actor_critic import Policy, PolicyConfig
from buggy_rl.policies.training.checkpoint import load_checkpoint
from buggy_rl.policies.training.collecting import Episodes
from buggy_rl.policies.training.ppo import PPO, minibatch_sizes
from buggy_rl.policies.training.ppo_config import PPOConfig
from buggy_rl.policies.training.run import PolicyRunConfig
from buggy_rl.policies.training.trainer import NonFiniteLossError
from buggy_rl.task.config import TaskConfig
from buggy_rl.task.env import make_env

CARS, STEPS, LIMIT = 8, 16, 7
BOUND = 1.0  # beyond it the point has failed


class Point(EnvBase):
    """x' = x + 0.4 u;  reward 1 - |x - 0.5|;  terminated beyond `BOUND`."""

    batch_locked = True

    def __init__(self, cars=CARS):
        super().__init__(batch_size=[cars])
        place = Unbounded((cars, 1))
        self.observation_spec = Composite(x=place, observation=place.clone(), shape=[cars])
        self.state_spec = Composite(x=place.clone(), shape=[cars])
        self.action_spec = Bounded(-1.0, 1.0, (cars, 2))
        self.reward_spec = Unbounded((cars, 1))
        flag = Binary(1, shape=(cars, 1), dtype=torch.bool)
        self.full_done_spec = Composite(done=flag, terminated=flag.clone(), shape=[cars])

    def _reset(self, tensordict=None, **_):
        x = 1.2 * torch.rand(*self.batch_size, 1) - 0.6
        return TensorDict({"x": x, "observation": x.clone()}, self.batch_size)

    def _step(self, tensordict):
        x = tensordict["x"] + 0.4 * tensordict["action"][..., :1].clamp(-1, 1)
        failed = x.abs() > BOUND
        return TensorDict(
            {
                "x": x,
                "observation": x.clone(),
                "reward": 1 - (x - 0.5).abs(),
                "done": failed,
                "terminated": failed.clone(),
            },
            self.batch_size,
        )

    def _set_seed(self, seed):
        pass


class Wind(Transform):
    """Pushes the reward about, with a generator and a count of its own, to be checkpointed."""

    def __init__(self):
        super().__init__()
        self.generator = torch.Generator().manual_seed(3)
        self.calls = torch.zeros(())

    def _step(self, tensordict, next_tensordict):
        self.calls = self.calls + 1
        gust = torch.rand(next_tensordict["reward"].shape, generator=self.generator)
        return next_tensordict.set("reward", next_tensordict["reward"] + 0.01 * self.calls * gust)

    def _reset(self, tensordict, tensordict_reset):
        return tensordict_reset


def point(*transforms, cars=CARS):
    return TransformedEnv(Point(cars), Compose(*transforms, StepCounter(max_steps=LIMIT)))


def config(**changes):
    settings = {"cars": CARS, "batch_steps": STEPS, "epochs": 2, "minibatch": 32, "steps": 512}
    return PPOConfig(**(settings | changes))


def value_is_observation():
    """A policy whose critic says V(o) = o."""
    policy = Policy(1, PolicyConfig(hidden=[], scaling="none"))
    with torch.no_grad():
        policy.value_layers[0].weight.fill_(1.0)
    return policy


def estimated(terminated, truncated):
    """Advantages of three steps with V = 10, 20, 30, rewards 1, 2, 3, and V of what followed."""
    run = PPO(point(), value_is_observation(), config(discount=0.9, trace=0.5))
    # After an end at step 1 the car is at 25 and is then set down at 30 for step 2.
    following = torch.tensor([20.0, 25.0, 40.0])
    done = torch.tensor([False, True, False])
    batch = TensorDict(
        {
            "observation": torch.tensor([10.0, 20.0, 30.0]).reshape(1, 3, 1),
            "next": {
                "observation": following.reshape(1, 3, 1),
                "reward": torch.tensor([1.0, 2.0, 3.0]).reshape(1, 3, 1),
                "done": done.reshape(1, 3, 1),
                "terminated": (done & terminated).reshape(1, 3, 1),
                "truncated": (done & truncated).reshape(1, 3, 1),
            },
        },
        [1, 3],
    )
    with torch.no_grad():
        run.estimate(batch)
    return batch


def test_nothing_follows_a_termination():
    # delta_2 = 3 + 0.9 * 40 - 30 = 9                      A_2 = 9 (the batch ends, not the episode)
    # delta_1 = 2 - 20 = -18                               A_1 = -18
    # delta_0 = 1 + 0.9 * 20 - 10 = 9                      A_0 = 9 + 0.45 * (-18) = 0.9
    batch = estimated(terminated=True, truncated=False)
    torch.testing.assert_close(batch["advantage"].flatten(), torch.tensor([0.9, -18.0, 9.0]))
    torch.testing.assert_close(batch["value_target"].flatten(), torch.tensor([10.9, 2.0, 39.0]))


def test_the_critic_speaks_for_what_a_truncation_cut_off():
    # delta_1 = 2 + 0.9 * 25 - 20 = 4.5, of the true last observation, not of the one reset to
    # A_1 = 4.5; A_0 = 9 + 0.45 * 4.5 = 11.025; A_2 = 9
    batch = estimated(terminated=False, truncated=True)
    torch.testing.assert_close(batch["advantage"].flatten(), torch.tensor([11.025, 4.5, 9.0]))
    torch.testing.assert_close(batch["value_target"].flatten(), torch.tensor([21.025, 24.5, 39.0]))


def test_advantages_of_collected_batches_are_those_of_the_textbook():
    torch.manual_seed(0)
    settings = config(discount=0.97, trace=0.9)
    run = PPO(point(), Policy(1, PolicyConfig(initial_sd=1.5)), settings)
    batch = next(iter(run.collector))
    with torch.no_grad():
        run.estimate(batch)
        critic = run.policy.critic()
        value = critic(batch.select("observation"))["state_value"]
        following = critic(batch["next"].select("observation"))["state_value"]
    done, terminated = batch["next", "done"], batch["next", "terminated"]
    assert terminated.any()
    assert (done & ~terminated).any()
    assert torch.equal(batch["next", "truncated"] & ~terminated, done & ~terminated)
    expected, later = torch.empty_like(value), torch.zeros(CARS, 1)
    for t in reversed(range(STEPS)):
        delta = batch["next", "reward"][:, t] - value[:, t]
        delta = delta + 0.97 * following[:, t] * ~terminated[:, t]
        later = expected[:, t] = delta + 0.97 * 0.9 * later * ~done[:, t]
    torch.testing.assert_close(batch["advantage"], expected, atol=1e-4, rtol=1e-4)


def test_a_batch_shows_the_true_last_observation_and_then_a_new_episode():
    torch.manual_seed(0)
    run = PPO(point(), Policy(1), config())
    batch = next(iter(run.collector))
    done = batch["next", "done"][:, :-1, 0]
    here, there = batch["observation"][:, 1:, 0], batch["next", "observation"][:, :-1, 0]
    assert done.any()
    assert torch.equal(here[~done], there[~done])
    assert (here[done] != there[done]).all()
    assert (here[done].abs() <= 0.6).all()  # set down where resets set down


def test_it_learns_to_go_where_the_reward_is():
    torch.manual_seed(0)
    env = point(cars=64)
    learning = {"epochs": 8, "minibatch": 256, "learning_rate": 1e-2, "discount": 0.9}
    settings = config(cars=64, steps=64 * STEPS * 30, **learning)
    policy = Policy(1, PolicyConfig(hidden=[16], initial_sd=0.3))
    rewards = [m["reward"] for m in PPO(env, policy, settings).run()]
    assert rewards[0] < 0.6
    assert rewards[-1] > 0.88
    x = torch.tensor([[0.0], [0.5], [0.9]])
    push = policy.driver()(TensorDict({"observation": x}, [3]))["action"][:, 0]
    # 0.5 lies 0.5 to the right of the first: a full push. It is where the second is already, and
    # 0.4 to the left of the third.
    torch.testing.assert_close(push, torch.tensor([1.0, 0.0, -1.0]), atol=0.35, rtol=0)


def curve(rows):
    """Metrics without those that a clock decides."""
    timed = ("speed", "seconds_left")
    return [{k: v for k, v in row.items() if k not in timed and v == v} for row in rows]


def stack():
    return point(Wind(), CatFrames(N=3, dim=-1, in_keys=["observation"]))


def test_a_resumed_run_gives_the_same_curve_bit_for_bit(tmp_path):
    torch.manual_seed(1)
    whole = PPO(stack(), Policy(3), config())
    rows = []
    for metrics in whole.run():
        rows.append(metrics)
        if len(rows) == 2:
            save_torch(tmp_path / "checkpoint.pt", whole.state_dict())
    assert len(rows) == 4
    torch.manual_seed(999)  # another program, which has drawn other numbers
    again = PPO(stack(), Policy(3), config())
    again.load_state_dict(load_checkpoint(tmp_path / "checkpoint.pt"))
    assert curve(again.run()) == curve(rows[2:])
    for name, tensor in whole.policy.state_dict().items():
        assert torch.equal(tensor, again.policy.state_dict()[name]), name


def test_a_seeded_run_resumes_bit_for_bit_too(tmp_path):
    task = build(
        TaskConfig,
        [
            "paths.count=4",
            "paths.waypoints=40",
            "transforms.noise.name=observation_noise",
            "transforms.step_limit.options.max_steps=9",
        ],
    )

    def seeded():
        env = make_env("kinematic", task=task, batch_size=CARS)
        env.set_seed(11)
        return env

    torch.manual_seed(1)
    whole = PPO(seeded(), Policy(23), config())
    batches = whole.run()
    next(batches)
    save_torch(tmp_path / "checkpoint.pt", whole.state_dict())
    rest = curve(batches)
    torch.manual_seed(999)
    again = PPO(seeded(), Policy(23), config())
    again.load_state_dict(load_checkpoint(tmp_path / "checkpoint.pt"))
    assert curve(again.run()) == rest


def test_ppo_uses_nothing_private_of_the_collector_to_resume():
    torch.manual_seed(1)
    run = PPO(stack(), Policy(3), config())
    state, batch = run.collector.state.clone(), run.collector.rollout()
    assert batch.batch_size == (CARS, STEPS)
    assert torch.equal(batch["observation"][:, 0], state["observation"])
    tree = ast.parse(inspect.getsource(PPO))
    taken = [node for node in ast.walk(tree) if isinstance(node, ast.Attribute)]
    private = [n.attr for n in taken if n.attr.startswith("_") and not n.attr.startswith("__")]
    assert set(private) <= set(vars(PPO))


def test_a_checkpoint_of_another_task_is_refused_in_one_line():
    state = PPO(stack(), Policy(3), config()).state_dict()
    state["cars"]["limited_action"] = state["cars"].pop("x")
    with pytest.raises(ValueError, match="another environment: limited_action, x is in only one"):
        PPO(stack(), Policy(3), config()).load_state_dict(state)


@pytest.mark.parametrize("left_out", ["cars", "environment", "random", "minibatches", "optimiser"])
def test_every_part_of_a_checkpoint_is_needed_for_that(left_out):
    torch.manual_seed(1)
    whole = PPO(stack(), Policy(3), config())
    batches = whole.run()
    next(batches)
    state = whole.state_dict()
    second = curve([next(batches)])
    torch.manual_seed(999)
    fresh = PPO(stack(), Policy(3), config(seed=8))
    fresh.load_state_dict(state | {left_out: fresh.state_dict()[left_out]})
    assert curve([next(fresh.run())]) != second


def test_a_checkpoint_of_another_environment_is_refused():
    state = PPO(stack(), Policy(3), config()).state_dict()
    other = PPO(point(CatFrames(N=3, dim=-1, in_keys=["observation"])), Policy(3), config())
    with pytest.raises(ValueError, match="generator is in only one of the two"):
        other.load_state_dict(state)


def test_one_seed_is_one_curve_and_another_is_another():
    curves = []
    for seed in (1, 1, 2):
        torch.manual_seed(seed)
        curves.append(curve(PPO(point(), Policy(1), config(steps=256)).run()))
    assert curves[0] == curves[1]
    assert curves[0] != curves[2]


@pytest.mark.parametrize(
    ("rows", "largest", "sizes"),
    [(9, 4, [3, 3, 3]), (10, 4, [4, 3, 3]), (3, 2, [2, 1]), (8, 4, [4, 4]), (3, 9, [3])],
)
def test_minibatches_hold_every_row_once_and_none_is_a_small_remainder(rows, largest, sizes):
    assert minibatch_sizes(rows, largest) == sizes


@pytest.mark.parametrize("minibatch", [1, 2, 4])
def test_minibatches_of_one_row_are_finite(minibatch):
    torch.manual_seed(0)
    tiny = PPOConfig(cars=3, batch_steps=3, minibatch=minibatch, steps=9)
    policy = Policy(1)
    (row,) = PPO(point(cars=3), policy, tiny).run()
    assert math.isfinite(row["loss_objective"])
    assert all(tensor.isfinite().all() for tensor in policy.state_dict().values())


class Fault(Transform):
    """The reward of one car is no number from the second batch on."""

    calls = 0

    def _step(self, tensordict, next_tensordict):
        self.calls += 1
        if self.calls > STEPS:
            next_tensordict["reward"][0] = math.nan
        return next_tensordict


def test_a_loss_that_is_no_number_stops_the_run_and_hands_over_the_batch():
    torch.manual_seed(0)
    run = PPO(point(Fault()), Policy(1), config())
    batches = run.run()
    next(batches)
    before = {name: tensor.clone() for name, tensor in run.policy.state_dict().items()}
    with pytest.raises(NonFiniteLossError, match=r"loss is nan after 128 steps") as caught:
        next(batches)
    assert isinstance(caught.value, FloatingPointError)
    assert caught.value.batch["value_target"].isnan().any()
    told = caught.value.metrics
    assert told["steps"] == 256
    assert math.isnan(told["reward"])
    assert math.isnan(told["loss_critic"])
    assert told["learning_rate"] == pytest.approx(0.75 * 3e-3)
    for name, tensor in run.policy.state_dict().items():
        assert torch.equal(tensor, before[name]), name


def test_cars_that_do_not_add_up_are_refused():
    with pytest.raises(ValueError, match=r"8 cars, ppo\.cars is 9"):
        PPO(point(), Policy(1), config(cars=9))


def test_the_first_episodes_begin_at_all_ages_and_are_not_counted():
    torch.manual_seed(0)
    cars = 64
    staggered, together = (
        PPO(point(cars=cars), Policy(1), config(cars=cars, stagger=stagger, minibatch=512))
        for stagger in (True, False)
    )
    ages = next(iter(staggered.collector))["step_count"][:, 0, 0]
    assert ages.unique().tolist() == list(range(LIMIT))
    assert (next(iter(together.collector))["step_count"][:, 0] == 0).all()
    assert not staggered.episodes.whole.any()
    assert together.episodes.whole.all()


def test_episodes_are_summed_over_the_seams_of_batches():
    # Two cars, rewards numbered 1, 2, 3, ... in time; car 0 ends at steps 2, 3 and 7, car 1 at 5.
    steps = 9
    reward = torch.arange(1.0, steps + 1).expand(2, steps).unsqueeze(-1)
    done = torch.zeros(2, steps, 1, dtype=torch.bool)
    done[0, [2, 3, 7]] = True
    done[1, 5] = True
    batch = TensorDict({"next": {"done": done, "reward": reward}}, [2, steps])
    for cuts in ([9], [3, 6], [1, 1, 1, 1, 1, 1, 1, 1, 1], [4, 4, 1]):
        episodes = Episodes(torch.Size([2]), whole=True)
        for part in batch.split(cuts, 1):
            episodes.take(part)
        # car 0: 1+2+3 in 3 steps, 4 in 1, 5+6+7+8 in 4; car 1: 1+...+6 in 6
        found = sorted((length, total) for length, total, _ in episodes.last)
        assert found == [(1.0, 4.0), (3.0, 6.0), (4.0, 26.0), (6.0, 21.0)], cuts
        begun_before = Episodes(torch.Size([2]), whole=False)
        for part in batch.split(cuts, 1):
            begun_before.take(part)
        assert sorted(length for length, _, _ in begun_before.last) == [1.0, 4.0], cuts


def test_the_original_settings_are_the_original_study_s(repository: Path):
    run = build(PolicyRunConfig, [str(repository / "configs/ppo_original.yaml"), "output=x"])
    ppo = run.ppo
    assert (ppo.steps, ppo.clip, ppo.learning_rate, ppo.discount) == (3_000_000, 0.2, 5e-4, 0.998)
    assert (ppo.cars * ppo.batch_steps, ppo.epochs, ppo.minibatch, ppo.trace) == (
        2048,
        10,
        64,
        0.95,
    )
    assert (ppo.entropy_weight, ppo.schedule) == (0.0, "constant")
    assert (run.policy.hidden, run.policy.activation) == ([64, 64], "relu")
