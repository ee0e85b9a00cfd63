"""Every transform of ours and of TorchRL in a task: right through partial resets, or refused."""

from dataclasses import replace

import pytest
import torch
import torchrl.envs.transforms as torchrl_transforms
from torchrl.envs import Transform

from buggy_rl.core import keys
from buggy_rl.task.config import TaskConfig, TransformConfig, default_transforms
from buggy_rl.task.env import make_env
from buggy_rl.task.paths.making import PathConfig, make_paths
from buggy_rl.task.transforms import TRANSFORMS
from buggy_rl.task.transforms.base import TaskTransform
from buggy_rl.task.transforms.foreign import REFUSED, RIGHT
from tests.contracts.test_engines import make
from tests.contracts.test_transforms import stacked

CARS, STEPS, LIMIT = 3, 14, 5
PATHS = make_paths(PathConfig(count=3, waypoints=40))
WEIGHTS = {"waypoints_closed": 1.0, "progress": 3.0, "steering_effort": 0.2}


def task_env(**extra):
    """The default task with a short limit, and further places at its end."""
    stack = {
        **default_transforms(),
        "rewards": TransformConfig("rewards", {"weights": WEIGHTS}),
        "step_limit": TransformConfig("step_limit", {"max_steps": LIMIT}),
    }
    for place, config in extra.items():
        stack[place] = replace(config, before="" if place == "last" else config.before)
    return make_env(make("kinematic", (CARS,)), task=TaskConfig(transforms=stack), paths=PATHS)


def driven(env):
    """Rows (state, what follows it) of cars that end one after the other and begin anew."""
    env.set_seed(0)
    state = env.reset()
    state[keys.STEP_COUNT] = torch.tensor([[0], [2], [4]])
    generator = torch.Generator().manual_seed(1)
    rows = []
    for _ in range(STEPS):
        state[keys.ACTION] = torch.rand(CARS, 2, generator=generator) * 2 - 1
        data, state = env.step_and_maybe_reset(state)
        rows.append((data.exclude("next").clone(), data["next"].clone()))
    return rows


def observed(f):
    """Of a transform that computes from one row alone, after a reset as after a step."""
    return lambda before, after: [(f(a), f(b)) for a, b in zip(before, after, strict=True)]


def reward_of(f):
    return lambda before, after: [(None, f(b)) for b in after]


def last_three(before, after):
    frames, begun, rows = None, torch.ones(CARS, 1, dtype=torch.bool), []
    for a, b in zip(before, after, strict=True):
        fresh = a[keys.OBSERVATION].repeat(1, 3)
        frames = fresh if frames is None else torch.where(begun, fresh, frames)
        size = fresh.shape[-1] // 3
        following = torch.cat([frames[:, size:], b[keys.OBSERVATION]], -1)
        rows.append((frames, following))
        frames, begun = following, b[keys.DONE]
    return rows


def sums(before, after):
    total, rows = torch.zeros(CARS, 1), []
    for b in after:
        following = total + b[keys.REWARD]
        rows.append((total, following))
        total = following * ~b[keys.DONE]
    return rows


def firsts(before, after):
    first, rows = torch.ones(CARS, 1, dtype=torch.bool), []
    for b in after:
        rows.append((first, torch.zeros_like(first)))
        first = b[keys.DONE]
    return rows


def ages(before, after):
    age, rows = torch.tensor([[0], [2], [4]]), []
    for b in after:
        rows.append((age, age + 1))
        age = (age + 1) * ~b[keys.DONE]
    return rows


SEEN, AHEAD, REWARD = keys.OBSERVATION, keys.WAYPOINTS, keys.REWARD
ONE = {"in_keys": [SEEN], "out_keys": ["out"]}
OF_REWARD = {"in_keys": [REWARD], "out_keys": [REWARD]}
CASES = {  # options, place it stands before or "", key, and what is right
    "CatFrames": ({"N": 3, "dim": -1, **ONE}, "leave_path", "out", last_three),
    "CatTensors": (
        {"in_keys": [SEEN, keys.LAST_ACTION], "out_key": "out", "del_keys": False, "sort": False},
        "leave_path", "out",
        observed(lambda a: torch.cat([a[SEEN], a[keys.LAST_ACTION]], -1)),
    ),
    "ClipTransform": (
        {"low": -0.1, "high": 0.2, **ONE}, "", "out", observed(lambda a: a[SEEN].clamp(-0.1, 0.2))
    ),
    "DTypeCastTransform": (
        {"dtype_in": torch.float32, "dtype_out": torch.float64, **ONE}, "", "out",
        observed(lambda a: a[SEEN].double()),
    ),
    "DoubleToFloat": ({}, "", SEEN, observed(lambda a: a[SEEN].float())),
    "ExcludeTransform": (
        {"excluded_keys": [keys.HEADING_ERROR]}, "", SEEN, observed(lambda a: a[SEEN])
    ),
    "FiniteTensorDictCheck": ({}, "", SEEN, observed(lambda a: a[SEEN])),
    "FlattenObservation": (
        {"first_dim": -2, "last_dim": -1, "in_keys": [AHEAD], "out_keys": ["out"]}, "", "out",
        observed(lambda a: a[AHEAD].flatten(-2)),
    ),
    "InitTracker": ({}, "", "is_init", firsts),
    "ObservationNorm": (
        {"loc": 0.5, "scale": 2.0, **ONE}, "", "out", observed(lambda a: 2.0 * a[SEEN] + 0.5)
    ),
    "PermuteTransform": (
        {"dims": [-1, -2], "in_keys": [AHEAD], "out_keys": ["out"]}, "", "out",
        observed(lambda a: a[AHEAD].mT),
    ),
    "RenameTransform": (
        {"in_keys": [AHEAD], "out_keys": ["out"], "create_copy": True}, "", "out",
        observed(lambda a: a[AHEAD]),
    ),
    "RewardClipping": (
        {"clamp_min": -0.01, "clamp_max": 0.02, **OF_REWARD}, "", REWARD,
        reward_of(lambda b: b[REWARD].clamp(-0.01, 0.02)),
    ),
    "RewardScaling": (
        {"loc": 0.5, "scale": 2.0, **OF_REWARD}, "", REWARD,
        reward_of(lambda b: 2.0 * b[REWARD] + 0.5),
    ),
    "RewardSum": ({}, "", "episode_reward", sums),
    "SignTransform": (OF_REWARD, "", REWARD, reward_of(lambda b: b[REWARD].sign())),
    "SqueezeTransform": (
        {"dim": -1, "in_keys": [keys.LATERAL_ERROR], "out_keys": ["out"]}, "", "out",
        observed(lambda a: a[keys.LATERAL_ERROR].squeeze(-1)),
    ),
    "StepCounter": (None, "", keys.STEP_COUNT, ages),
    "UnsqueezeTransform": (
        {"dim": -1, "in_keys": [SEEN], "out_keys": ["out"]}, "", "out",
        observed(lambda a: a[SEEN].unsqueeze(-1)),
    ),
}  # fmt: skip
ELSEWHERE = {"ActionScaling", "TensorDictPrimer"}
"""Tested by themselves below."""


@pytest.mark.parametrize("name", CASES)
def test_a_transform_of_torchrl_is_right_through_partial_resets(name):
    options, before, key, reference = CASES[name]
    plain = driven(task_env())
    extra = {} if options is None else {
        "mine": TransformConfig(f"torchrl.envs.transforms:{name}", options, before)
    }  # fmt: skip
    found = driven(task_env(**extra))
    assert sum(bool(after[keys.DONE].any()) for _, after in plain) > 5  # at different times
    expected = reference(*map(list, zip(*plain, strict=True)))
    for (a, b), (root, following), (before_, _) in zip(found, expected, plain, strict=True):
        assert torch.equal(a[keys.POSE], before_[keys.POSE])  # it moved no car
        if root is not None:
            torch.testing.assert_close(a[key], root)
        torch.testing.assert_close(b[key].reshape(following.shape), following)


def test_scaled_actions_drive_as_their_commands():
    env = task_env(command=TransformConfig("torchrl.envs.transforms:ActionScaling"))
    scaled, plain = driven(env), driven(task_env())
    for (a, _), (b, _) in zip(scaled, plain, strict=True):
        torch.testing.assert_close(a[keys.POSE], b[keys.POSE])


def test_a_primed_memory_is_zero_where_an_episode_begins():
    from torchrl.data import Composite, Unbounded

    env = task_env()
    memory = Composite(hidden=Unbounded((CARS, 2)), shape=(CARS,))
    env.append_transform(torchrl_transforms.TensorDictPrimer(memory))
    env.set_seed(0)
    state = env.reset()
    state[keys.STEP_COUNT] = torch.tensor([[0], [2], [4]])
    expected = torch.zeros(CARS, 2)
    for k in range(STEPS):
        torch.testing.assert_close(state["hidden"], expected)
        state[keys.ACTION] = torch.zeros(CARS, 2)
        state["next", "hidden"] = state["hidden"] + k + 1.0  # as a policy writes it
        data, state = env.step_and_maybe_reset(state)
        expected = (expected + k + 1.0) * ~data["next", keys.DONE]


@pytest.mark.parametrize("name", REFUSED)
def test_what_would_be_wrong_is_refused_in_one_line(name):
    with pytest.raises(ValueError, match=f"^{name} ") as caught:
        task_env(last=TransformConfig(f"torchrl.envs.transforms:{name}"))
    assert "\n" not in str(caught.value)
    assert any(mark in str(caught.value) for mark in (":", "leave it out"))


def test_every_transform_of_torchrl_is_right_or_refused():
    kinds = vars(torchrl_transforms).values()
    known = {k.__name__ for k in kinds if isinstance(k, type) and issubclass(k, Transform)}
    assert known - {"Transform", "ObservationTransform"} == set(RIGHT) | set(REFUSED)
    assert set(RIGHT) == set(CASES) | ELSEWHERE
    assert not set(RIGHT) & set(REFUSED)


def table():
    """The lists as the page has them, names of one reason in one row."""
    lines = ["| TorchRL's | in a task |", "|---|---|"]
    lines += [f"| `{name}` | {use} |" for name, use in RIGHT.items()]
    for reason in dict.fromkeys(REFUSED.values()):
        names = ", ".join(f"`{name}`" for name, why in REFUSED.items() if why == reason)
        lines.append(f"| {names} | *refused*: {reason} |")
    return "\n".join(lines)


def test_the_page_has_the_table(repository):
    assert table() in (repository / "docs" / "extending.md").read_text()


def test_a_step_count_that_ends_nothing_is_refused():
    options = {"max_steps": 5, "update_done": False}
    with pytest.raises(ValueError, match="update_done=false truncates episodes that are not done"):
        task_env(last=TransformConfig("torchrl.envs:StepCounter", options))


@pytest.mark.parametrize("name", [*TRANSFORMS, "everything"])
def test_a_car_of_a_batch_with_partial_resets_is_a_car_alone(name):
    env, lone = stacked(name, "kinematic", (CARS,)), stacked(name, "kinematic", (1,))
    env.set_seed(0)
    state = env.reset()
    generator, memory = torch.Generator().manual_seed(1), list(env.state_spec.keys(True, True))
    alone = [lone.reset(state[i : i + 1].select(*memory), set_state=True) for i in range(CARS)]
    for step in range(STEPS):
        state[keys.ACTION] = torch.rand(CARS, 2, generator=generator) * 2 - 1
        after = env.step(state)["next"].exclude(keys.REWARD)
        for i in range(CARS):
            own = alone[i].set(keys.ACTION, state[keys.ACTION][i : i + 1])
            alone[i] = lone.step(own)["next"].exclude(keys.REWARD)
            for key in alone[i].keys(True, True):
                torch.testing.assert_close(alone[i][key], after[key][i : i + 1], msg=key)
        ended = torch.tensor([step % 3 == 0, step % 4 == 0, step % 5 == 0])
        if ended.any():
            after.set("_reset", ended.unsqueeze(-1))
            after = env.reset(after, select_reset_only=True)
        state = after
        for i in ended.nonzero().flatten().tolist():
            alone[i] = lone.reset(state[i : i + 1].select(*memory), set_state=True)


class Bonus(TaskTransform):
    """One more for every step."""

    def _call(self, next_tensordict):
        reward = next_tensordict.get(keys.REWARD, None)
        return next_tensordict if reward is None else next_tensordict.set(keys.REWARD, reward + 1)


class InPlace(TaskTransform):
    """The same, in place."""

    def _step(self, tensordict, next_tensordict):
        next_tensordict.get(keys.REWARD).add_(1.0)
        return next_tensordict


@pytest.mark.parametrize("name", ["Bonus", "InPlace"])
def test_a_reward_that_would_be_replaced_is_refused_and_one_behind_counts(name):
    own = TransformConfig(f"{__name__}:{name}", {}, "rewards")
    with pytest.raises(ValueError, match=f"{name} changes the reward before Rewards"):
        task_env(bonus=own)
    behind = driven(task_env(bonus=replace(own, before="step_limit")))
    for (_, more), (_, plain) in zip(behind, driven(task_env()), strict=True):
        torch.testing.assert_close(more[keys.REWARD], plain[keys.REWARD] + 1)
