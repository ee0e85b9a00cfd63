"""Every transform of the shipped tasks can be swapped for any other, or is refused in one line."""

from dataclasses import replace

import pytest
import torch
from torchrl.envs.utils import check_env_specs

from buggy_rl.core.config import build
from buggy_rl.policies.training.run import PolicyRunConfig
from buggy_rl.task.config import TransformConfig, default_transforms, transforms_in_order
from buggy_rl.task.env import make_env
from buggy_rl.task.paths.making import PathConfig, make_paths
from buggy_rl.task.transforms import TRANSFORMS
from tests.contracts.test_engines import make

SHIPPED = {  # config files of a run, and those of the task alone
    "default": [],
    "task_waypoints": ["task_waypoints"],
    "ppo": ["ppo"],
    "ppo_car": ["ppo", "ppo_car"],
}
PATHS = make_paths(PathConfig(count=3, waypoints=40))
INSTEAD = {  # name -> places of `ppo_car` where it does something sensible
    "action_smoothing": ["command"],
    "rate_limit": ["command"],
    "past_mean": ["filter", "clip"],
    "clip_velocity": ["filter"],
    "target_speed": ["target_speed"],
    "history": ["history"],
    "observation": ["observation"],
}


def task(files, overrides, repository, tmp_path):
    """A shipped task, as the command line of `scripts/train_policy.py` builds it."""
    arguments = []
    for name in SHIPPED[files]:
        file = repository / "configs" / f"{name}.yaml"
        if name.startswith("task_"):
            nested = tmp_path / file.name
            lines = file.read_text().splitlines()
            nested.write_text("task:\n" + "\n".join(f"  {line}" for line in lines))
            file = nested
        arguments.append(str(file))
    overrides = [f"task.{override}" for override in overrides]
    return build(PolicyRunConfig, [*arguments, *overrides, "output=x"]).task


def stacked(config, batch_size=(3,)):
    return make_env(make("kinematic", batch_size), task=config, paths=PATHS)


@pytest.mark.parametrize("files", list(SHIPPED))
def test_another_name_in_a_place_drops_the_options_of_the_shipped_one(files, repository, tmp_path):
    shipped = task(files, [], repository, tmp_path).transforms
    overrides = [f"transforms.{place}.name=mine.py:Other" for place in shipped]
    swapped = task(files, overrides, repository, tmp_path).transforms
    assert all(config.options == {} for config in swapped.values())
    overrides = [f"transforms.{place}.name={config.name}" for place, config in shipped.items()]
    assert task(files, overrides, repository, tmp_path).transforms == shipped


@pytest.mark.parametrize(
    ("files", "share"),
    [
        pytest.param("task_waypoints", 1, marks=pytest.mark.slow),
        pytest.param("ppo_car", 1, marks=pytest.mark.slow),
        ("ppo_car", 4),  # every transform in every fourth place, each place with every fourth
    ],
)
def test_a_place_takes_any_transform_or_refuses_it_in_one_line(files, share, repository, tmp_path):
    shipped, refusals = task(files, [], repository, tmp_path), []
    for row, place in enumerate(default_transforms()):
        for column, name in enumerate((*TRANSFORMS, "none")):
            if (row + column) % share:
                continue
            stack = {**shipped.transforms, place: TransformConfig(name)}
            try:
                env = stacked(replace(shipped, transforms=stack))
            except ValueError as error:
                refusals.append(str(error))
                continue
            assert env.rollout(2)["next", "pose"].isfinite().all(), (place, name)
    assert len(refusals) > 50 // share
    assert [text for text in refusals if "\n" in text or "option" in text] == []


@pytest.mark.parametrize("name", INSTEAD)
def test_a_transform_stands_where_it_makes_sense(name, repository, tmp_path):
    for place in INSTEAD[name]:
        config = task("ppo_car", [f"transforms.{place}.name={name}"], repository, tmp_path)
        env = stacked(config)
        kind = TRANSFORMS[name].rpartition(":")[2]
        assert kind in [type(t).__name__ for t in env.transform]
        check_env_specs(env)


def test_another_transform_takes_only_its_own_options(repository, tmp_path):
    command = "transforms.command"
    overrides = [f"{command}.options.time_constant=0.1", f"{command}.name=action_smoothing"]
    for given in (overrides, overrides[::-1]):
        config = task("task_waypoints", given, repository, tmp_path).transforms["command"]
        assert config == TransformConfig("action_smoothing", {"time_constant": 0.1})
    assert stacked(task("task_waypoints", overrides[1:], repository, tmp_path)).rollout(2).numel()


TORCHRL = {  # place and options of TorchRL's own
    "RewardScaling": ("scaling", {"loc": 0.5, "scale": 2.0}),
    "RewardSum": ("sum", {}),
    "RewardClipping": ("clipping", {"clamp_min": -0.1, "clamp_max": 0.1}),
    "SignTransform": ("sign", {"in_keys": ["reward"]}),
    "ObservationNorm": ("history", {"loc": 0.0, "scale": 2.0, "in_keys": ["observation"]}),
    "CatFrames": ("history", {"N": 3, "dim": -1, "in_keys": ["observation"]}),
    "ClipTransform": ("history", {"in_keys": ["observation"], "low": -1.0, "high": 1.0}),
    "UnsqueezeTransform": ("history", {"dim": -1, "in_keys": ["waypoints"]}),
    "FlattenObservation": ("history", {"first_dim": -2, "last_dim": -1, "in_keys": ["waypoints"]}),
    "CatTensors": (
        "history",
        {"in_keys": ["observation", "last_action"], "out_key": "observation", "del_keys": False},
    ),
    "ExcludeTransform": ("history", {"excluded_keys": ["heading_error"]}),
    "InitTracker": ("first", {}),
    "StepCounter": ("step_limit", {"max_steps": 5}),
    "DoubleToFloat": ("first", {}),
    "ActionScaling": ("command", {}),
}


@pytest.mark.parametrize("name", TORCHRL)
def test_torchrls_own_transforms_stand_in_a_shipped_task(name, repository, tmp_path):
    place, options = TORCHRL[name]
    overrides = [f"transforms.{place}.options.{k}={v}" for k, v in options.items()]
    overrides.append(f"transforms.{place}.name=torchrl.envs:{name}")
    env = stacked(task("ppo_car", [o.replace("'", "") for o in overrides], repository, tmp_path))
    check_env_specs(env)
    assert any(name in type(t).__name__ for t in env.transform)


def test_reward_scaling_scales_the_reward(repository, tmp_path):
    scaling = TransformConfig("torchrl.envs:RewardScaling", {"loc": 0.5, "scale": 2.0})
    plain = task("ppo", [], repository, tmp_path)
    rewards = []
    for stack in (plain.transforms, {**plain.transforms, "scaling": scaling}):
        env = stacked(replace(plain, transforms=stack))
        env.set_seed(0)
        torch.manual_seed(0)  # of the random actions
        rewards.append(env.rollout(5)["next", "reward"])
    torch.testing.assert_close(rewards[1], 2.0 * rewards[0] + 0.5)


@pytest.mark.parametrize(
    ("place", "name", "options", "message"),
    [
        ("command", "RewardScaling", {"loc": 0.0, "scale": 1.0}, "reads reward, which Rewards"),
        ("step_limit", "RewardScaling", {}, "missing 2 required positional arguments"),
        ("noise", "ObservationNorm", {"loc": 0, "scale": 1, "in_keys": ["observation"]}, "reads o"),
        ("history", "ObservationNorm", {"in_keys": ["observation"]}, "not been initialized"),
        ("history", "CatFrames", {"N": 3, "dim": -1, "in_keys": ["observatio"]}, "nothing before"),
        ("history", "CatFrames", {"N": 3, "sizes": 3}, "no option sizes; available: N, "),
        ("history", "ExcludeTransform", {"excluded_keys": ["pose"]}, "takes away pose"),
        ("history", "VecNormV2", {"in_keys": ["observation"]}, "use ObservationNorm with loc"),
        ("history", "NoSuch", {}, "has no 'NoSuch'"),
    ],
)
def test_what_cannot_work_where_it_stands_is_refused_in_one_line(place, name, options, message):
    stack = {**default_transforms(), place: TransformConfig(f"torchrl.envs:{name}", options)}
    config = build(PolicyRunConfig, ["output=x"]).task
    with pytest.raises(ValueError, match=message) as caught:
        stacked(replace(config, transforms=stack))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["rate_limit", "past_mean", "observation_noise", "waypoints"])
def test_a_transform_with_a_memory_cannot_stand_twice(name):
    stack = default_transforms()
    stack |= {place: TransformConfig(name) for place in ("noise", "filter")}
    config = build(PolicyRunConfig, ["output=x"]).task
    assert len([c for c in transforms_in_order(stack) if c.name == name]) >= 2
    with pytest.raises(ValueError, match="stands twice in the stack"):
        stacked(replace(config, transforms=stack))
