"""Short-horizon actor-critic: its gradient, its returns, its resumption and what it refuses."""

from copy import deepcopy
from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase, StepCounter, TransformedEnv

from buggy_rl.core.config import build
from buggy_rl.policies.training.actor_critic import Policy, PolicyConfig
from buggy_rl.policies.training.run import PolicyRunConfig, new_engine, validation_environment
from buggy_rl.policies.training.run import validate as validated
from buggy_rl.policies.training.shac import SHAC, SHACConfig
from buggy_rl.policies.training.trainer import NonFiniteLossError
from buggy_rl.task.env import make_env

CARS, LIMIT = 4, 7


class Slope(EnvBase):
    """x' = x + u / 10; r = -x'^2; a car beyond |x| = 2 has failed."""

    def __init__(self, cars=CARS, steep=1.0):
        super().__init__(batch_size=[cars])
        self.steep = steep
        number = Unbounded((cars, 1))
        self.observation_spec = Composite(
            {"observation": number, "velocity": number.clone()}, shape=[cars]
        )
        self.state_spec = Composite({"observation": number.clone()}, shape=[cars])
        self.action_spec = Bounded(-1.0, 1.0, (cars, 2))
        self.reward_spec = Unbounded((cars, 1))
        flag = Binary(1, shape=(cars, 1), dtype=torch.bool)
        self.full_done_spec = Composite({"done": flag, "terminated": flag.clone()}, shape=[cars])

    def _reset(self, tensordict=None, **_):
        x = torch.linspace(-1.0, 1.0, self.batch_size[0]).unsqueeze(-1)
        return TensorDict({"observation": x, "velocity": x.clone()}, self.batch_size)

    def _step(self, tensordict):
        x = tensordict["observation"] + self.steep * tensordict["action"].sum(-1, True) / 10
        failed = x.detach().abs() > 2.0
        moved = {"observation": x, "velocity": x.clone(), "reward": -x.square()}
        return TensorDict({**moved, "done": failed, "terminated": failed.clone()}, self.batch_size)

    def _set_seed(self, seed):
        pass


def slope(**options):
    return TransformedEnv(Slope(**options), StepCounter(max_steps=LIMIT))


def training(env=None, **changes):
    torch.manual_seed(1)
    policy = Policy(1, PolicyConfig(hidden=[4], activation="tanh", scaling="none"))
    settings = {"steps": 400, "cars": CARS, "batch_steps": 10, "epochs": 2, "minibatch": 32}
    return SHAC(env or slope(), policy, SHACConfig(**(settings | changes)))


def test_the_gradient_is_that_of_what_the_steps_are_worth():
    run = training(stagger=False)
    weight = run.policy.mean_layers[-1].bias
    state = deepcopy(run.state_dict())

    def gain(moved):
        run.load_state_dict(deepcopy(state))
        with torch.no_grad():
            weight.add_(moved)
        return run._driven()[1]

    (slope_of_it,) = torch.autograd.grad(gain(0.0), weight)
    for index in range(2):
        step = torch.zeros(2)
        step[index] = 1e-2
        difference = (gain(step) - gain(-step)).item() / 2e-2
        assert slope_of_it[index].item() == pytest.approx(difference, rel=0.02)


def test_returns_end_with_an_episode_and_with_the_critics_view_of_what_is_cut_off():
    # gamma 0.5, V' = o: G_2 = 3 + 0.5 * 8 = 7, cut off by the batch; G_1 = 2, the car failed;
    # G_0 = 1 + 0.5 * G_1 = 2.
    run = training(discount=0.5)
    run.target = torch.nn.Identity()
    done = torch.tensor([False, True, False]).reshape(1, 3, 1)
    after = {
        "observation": torch.tensor([5.0, 6.0, 8.0]).reshape(1, 3, 1),
        "reward": torch.tensor([1.0, 2.0, 3.0]).reshape(1, 3, 1),
        "done": done,
        "terminated": done,
    }
    batch = TensorDict({"next": after}, [1, 3])
    assert run._returns(batch, 1.0).flatten().tolist() == [2.0, 2.0, 7.0]
    # A truncation instead: G_1 = 2 + 0.5 * 6 = 5, G_0 = 1 + 0.5 * 5 = 3.5.
    batch["next", "terminated"] = torch.zeros_like(done)
    assert run._returns(batch, 1.0).flatten().tolist() == [3.5, 5.0, 7.0]


def test_a_car_that_is_set_down_again_begins_a_sum_of_its_own():
    run = training(stagger=False)  # ends after 7 steps, so that 3 of 10 are of a second episode
    batch, gain = run._driven()
    assert batch["next", "done"].sum() == CARS
    worth = run._returns(batch, 1.0)
    begins = worth[:, 0].sum() + worth[:, LIMIT].sum()
    assert gain.item() == pytest.approx(begins.item() / batch.numel(), rel=1e-5)
    assert not batch["next", "reward"].requires_grad


def test_it_brings_a_car_to_where_the_reward_is_largest():
    run = training(steps=4000, learning_rate=2e-2)
    rewards = [metrics["reward"] for metrics in run.run()]
    assert run.steps == 4000
    assert rewards[-1] > 0.5 * rewards[0]  # both below nothing
    assert rewards[-1] > rewards[0] + 0.1


def test_a_resumed_run_goes_on_bit_for_bit():
    whole = training()
    batches = whole.run()
    next(batches)
    state = deepcopy(whole.state_dict())
    rest = [metrics["loss_objective"] for metrics in batches]
    again = training()
    again.load_state_dict(state)
    assert [metrics["loss_objective"] for metrics in again.run()] == rest
    assert len(rest) == 9


class Uneven(Slope):
    """r = push u_1 - hard: even cars push half as much, every other pair has a hard path."""

    def __init__(self, cars=8):
        super().__init__(cars)
        index = torch.arange(cars).unsqueeze(-1)
        self.push, self.hard = 1.0 - 0.5 * (index % 2 == 0), (index // 2 % 2).float()

    def _reset(self, tensordict=None, **_):
        seen = {"observation": self.hard.clone(), "velocity": torch.zeros_like(self.hard)}
        return TensorDict(seen, self.batch_size)

    def _step(self, tensordict):
        drive = tensordict["action"][..., :1].clamp(0.0, 1.0)
        moved = {"observation": self.hard.clone(), "velocity": drive, "reward": self.push * drive}
        moved["reward"] = moved["reward"] - self.hard
        over = {key: torch.zeros_like(drive, dtype=torch.bool) for key in ("done", "terminated")}
        return TensorDict({**moved, **over}, self.batch_size)


def uneven(**changes):
    env = TransformedEnv(Uneven(), StepCounter(max_steps=LIMIT))
    settings = {"cars": 8, "steps": 4800, "critic_rate": 2e-2, "discount": 0.8, "epochs": 6}
    return training(env, **(settings | changes))


def test_the_actor_follows_the_cars_with_a_weak_throttle_and_not_those_on_a_hard_path():
    run = uneven(worst=0.5)
    chosen, by_return = [], []
    worst = run._worst

    def noted(batch, gains, begins):
        by_return.append(gains.sum((-2, -1)).flatten().topk(4, largest=False).indices)
        chosen.append(worst(batch, gains, begins))
        return chosen[-1]

    run._worst = noted
    list(run.run())
    weak, hard = [0, 2, 4, 6], [2, 3, 6, 7]
    assert all(sorted(cars.tolist()) == weak for cars in chosen[-20:])
    assert sorted(by_return[-1].tolist()) == hard  # what a rank by return alone would follow


class Apart(Uneven):
    """r = -(u_1 - c)^2, with c = 1 for a quarter of the cars and 0 for the others."""

    def __init__(self):
        super().__init__()
        self.hard = torch.zeros_like(self.hard)  # all look alike
        self.best = (torch.arange(8).unsqueeze(-1) % 4 == 3).float()

    def _step(self, tensordict):
        command = tensordict["action"][..., :1]
        moved = {"reward": -(command - self.best).square(), "velocity": command}
        return super()._step(tensordict).update(moved)


@pytest.mark.parametrize(("worst", "best"), [(1.0, 0.25), (0.25, 0.5)])
def test_the_policy_goes_to_where_the_mean_over_the_worst_cars_is_largest(worst, best):
    # Of all cars -(0.75 u^2 + 0.25 (u - 1)^2), largest at 1/4; of the worst quarter
    # -max(u^2, (u - 1)^2), largest at 1/2.
    env = TransformedEnv(Apart(), StepCounter(max_steps=LIMIT))
    settings = {"cars": 8, "steps": 6400, "epochs": 1, "minibatch": 80, "learning_rate": 3e-2}
    run = training(env, worst=worst, discount=0.0, **settings)
    list(run.run())
    command = run.policy.mean_layers(torch.zeros(1))[0].item()
    assert command == pytest.approx(best, abs=0.08)


@pytest.mark.parametrize(("worst", "followed"), [(0.01, 1), (0.25, 2), (0.5, 4), (0.9, 7)])
def test_the_gradient_is_that_of_the_mean_over_the_worst_share_of_cars(worst, followed):
    run = uneven(worst=worst)
    batch, gain = run._driven()
    begins = batch["next", "done"].roll(1, -2)
    begins[:, 0] = True
    gains = (run._returns(batch, 1.0) * begins).sum((-2, -1))
    expected = (run.target(run.policy.scaling(batch["observation"])) * begins).sum((-2, -1))
    cars = (gains - expected).argsort()[:followed]
    assert gain.item() == pytest.approx(gains[cars].mean().item() / 10, rel=1e-5)


def test_with_all_cars_none_is_ranked(monkeypatch):
    monkeypatch.setattr(SHAC, "_worst", None)
    assert len(list(uneven(steps=160).run())) == 2


def test_a_resumed_run_ranks_cars_by_the_same_means():
    whole = uneven(steps=800, worst=0.5)
    batches = whole.run()
    for _ in range(3):
        next(batches)
    state = deepcopy(whole.state_dict())
    rest = [metrics["loss_objective"] for metrics in batches]
    again = uneven(steps=800, worst=0.5)
    again.load_state_dict(deepcopy(state))
    assert [metrics["loss_objective"] for metrics in again.run()] == rest
    assert torch.equal(again.surprise, whole.surprise)
    forgetful = uneven(steps=800, worst=0.5)
    forgetful.load_state_dict(state | {"surprise": -state["surprise"]})
    assert [metrics["loss_objective"] for metrics in forgetful.run()] != rest


@pytest.mark.parametrize("worst", [0.0, -0.5, 1.1, float("nan")])
def test_a_share_of_cars_outside_its_range_is_refused(worst):
    with pytest.raises(ValueError, match=r"shac.worst is .*: must be above 0 and at most 1"):
        SHACConfig(worst=worst)


def test_a_gradient_that_is_not_finite_ends_the_run():
    run = training(slope(steep=float("inf")))
    with pytest.raises(NonFiniteLossError, match="gradient of the actor is nan after 0 steps"):
        next(run.run())


@pytest.mark.parametrize("engine", ["mujoco", "hold"])
def test_a_simulator_without_gradients_is_refused(engine):
    with pytest.raises(ValueError, match="this simulator passes none: take a learned one"):
        SHAC(make_env(engine, batch_size=4), Policy(23), SHACConfig(cars=4))


def test_another_number_of_cars_and_other_processes_are_refused():
    with pytest.raises(ValueError, match=r"has 4 cars, shac.cars is 8: make them equal"):
        training(cars=8)
    with pytest.raises(ValueError, match="leave out collector"):
        SHAC(slope(), Policy(1), SHACConfig(cars=CARS), object())


@pytest.mark.parametrize("engine", ["kinematic", "single_track"])
def test_gradients_through_the_task_are_finite_from_rest_on(engine):
    config = build(PolicyRunConfig, ["configs/shac.yaml", "output=x"])
    env = make_env(engine, task=config.task, batch_size=8)
    torch.manual_seed(0)
    policy = Policy(env.observation_spec["observation"].shape[-1])
    run = SHAC(env, policy, SHACConfig(cars=8, steps=1, minibatch=64))
    (metrics,) = list(run.run())
    assert metrics["gradient_norm"] > 0


@pytest.mark.slow
def test_a_policy_keeps_all_validation_paths_after_half_a_minute():
    layers = ["configs/shac.yaml", "output=x", "engine.simulator=kinematic"]
    config = build(PolicyRunConfig, layers)
    settings = replace(config.shac, steps=150_000)
    torch.manual_seed(0)
    env = make_env(new_engine(config.engine, settings.cars), task=config.task)
    policy = Policy(env.observation_spec["observation"].shape[-1], config.policy)
    list(SHAC(env, policy, settings).run())
    scores = validated(validation_environment(config), policy, 1000)
    assert scores["validation_kept_on"] == 1.0
    assert scores["validation_waypoints"] > 100
