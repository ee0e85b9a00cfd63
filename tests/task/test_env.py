import math
import warnings
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torchrl.collectors import Collector
from torchrl.envs import (
    Compose,
    EnvBase,
    RewardSum,
    SerialEnv,
    StepCounter,
    Transform,
    TransformedEnv,
)
from torchrl.envs.utils import check_env_specs

import buggy_rl.task.env
from buggy_rl.core import keys
from buggy_rl.core import keys as task
from buggy_rl.core.config import ConfigError, build
from buggy_rl.task.config import (
    TaskConfig,
    TransformConfig,
    default_transforms,
    transforms_in_order,
)
from buggy_rl.task.env import make_env
from buggy_rl.task.paths.making import PathConfig
from buggy_rl.task.transforms import make_transform
from buggy_rl.task.transforms.commands import RateLimit
from buggy_rl.task.transforms.observation import History, PastMean
from tests.contracts.test_engines import make

FEW = TaskConfig(paths=PathConfig(count=5, waypoints=60))
ENGINES = ("learned", "mujoco", "reference", "single_track", "kinematic", "hold")


def changed(**places):
    """The default stack with some places filled otherwise."""
    transforms = default_transforms()
    transforms.update(places)
    return replace(FEW, transforms=transforms)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("batch_size", [(), (4,), (64,)], ids=["one", "four", "64"])
def test_the_task_stands_over_every_engine(engine, batch_size):
    env = make_env(make(engine, batch_size), task=FEW)
    check_env_specs(env)
    assert env.observation_spec[task.OBSERVATION].shape == (*batch_size, 23)


def test_every_engine_shows_the_policy_the_same():
    specs = {}
    for engine in ENGINES:
        bare = make(engine, (4,))
        env = make_env(bare, task=FEW)
        own = set(bare.observation_spec.keys()) - {keys.POSE, keys.VELOCITY}
        specs[engine] = {k: v for k, v in env.observation_spec.items() if k not in own}
        specs[engine] |= {"action": env.action_spec, **dict(env.full_done_spec.items())}
    first = specs["learned"]
    assert {task.OBSERVATION, task.LATERAL_ERROR, keys.TRUNCATED} <= set(first)
    for engine, spec in specs.items():
        assert spec == first, engine


def test_an_engine_is_made_from_its_name():
    env = make_env("kinematic", task=FEW, batch_size=7)
    assert env.batch_size == (7,)
    assert isinstance(env.base_env, EnvBase)


def bearing_driver(state):
    """Steers towards the third waypoint, with half throttle."""
    x, y = state[task.WAYPOINTS][..., 2, :].unbind(-1)
    steering = (3.0 * torch.atan2(y, x)).clamp(-1, 1)
    return torch.stack([torch.full_like(steering, -0.1), steering], -1)


@pytest.mark.parametrize("engine", ["single_track", "mujoco"])
@pytest.mark.parametrize("kind", ["lap", "infinity"])
def test_a_car_that_is_steered_at_its_waypoints_closes_them(engine, kind):
    paths = PathConfig(kind=kind)
    env = make_env(engine, task=replace(FEW, paths=paths))
    state, closed, way = env.reset(), 0.0, 0.0
    for _ in range(250):
        before = state[keys.POSE]
        state = env.step(state.set(keys.ACTION, bearing_driver(state)))["next"]
        closed += float(state[keys.REWARD])
        way += float((state[keys.POSE] - before)[:2].norm())
        assert not state[keys.DONE]
    assert closed > 10  # 2 m in 2.5 s from rest
    assert int(state[task.NEXT_WAYPOINT]) == 1 + closed
    # a waypoint each 0.2 m, along the path; the way driven is as long, within a corner cut
    assert closed == pytest.approx(float(state[task.PATH_POSITION]) / 0.2, abs=1.5)
    assert way == pytest.approx(float(state[task.PATH_POSITION]), rel=0.15)


def random_task(**places):
    """The default stack with everything that a reset can draw."""
    around = {"order": "random", "start_lateral": 0.2, "start_heading": 0.5}
    return changed(
        waypoints=TransformConfig("waypoints", around),
        noise=TransformConfig("observation_noise"),
        target_speed=TransformConfig("target_speed"),
        **places,
    )


def starts(env, seed=None):
    """Two resets after a seed, as flat dictionaries."""
    if seed is not None:
        env.set_seed(seed)
    return torch.stack([env.reset(), env.reset()])


def test_a_seed_fixes_starts_and_noise_whatever_else_is_drawn():
    task = random_task()
    first, second = (make_env("kinematic", task=task, batch_size=(16,)) for _ in range(2))
    torch.manual_seed(0)
    one = starts(first, seed=3)
    torch.manual_seed(1)
    assert (starts(second, seed=3) == one).all()
    torch.rand(7)
    assert (starts(first, seed=3) == one).all()
    other = starts(first, seed=4)
    for key in ("path", "noise_state", "target_speed", keys.POSE):
        assert not torch.equal(other[key], one[key]), key
        assert not torch.equal(one[key][0], one[key][1]), key  # the stream goes on


def test_a_seed_fixes_a_rollout_with_resets_in_between():
    limit = TransformConfig("step_limit", {"max_steps": 5})
    task = random_task(step_limit=limit)
    action = torch.tensor([0.2, 0.3]).expand(4, 2)
    rows = []
    for noise in (0, 1):
        env = make_env("kinematic", task=task, batch_size=(4,))
        env.set_seed(3)
        torch.manual_seed(noise)
        rows.append(
            env.rollout(12, lambda td: td.set(keys.ACTION, action), break_when_any_done=False)
        )
    assert (rows[0] == rows[1]).all()
    assert rows[0]["next", keys.DONE].any()


def test_a_seeded_environment_leaves_pytorchs_generator_alone():
    env = make_env("kinematic", task=random_task(), batch_size=(4,))
    before = torch.random.get_rng_state()
    assert env.set_seed(3) != 3  # the seed for a further environment
    assert env.set_seed(3, static_seed=True) == 3
    env.reset()
    assert torch.equal(torch.random.get_rng_state(), before)


def test_without_a_seed_pytorchs_generator_decides():
    drawn = []
    for seed in (5, 5, 6):
        torch.manual_seed(seed)
        drawn.append(starts(make_env("kinematic", task=random_task(), batch_size=(16,))))
    assert (drawn[0] == drawn[1]).all()
    assert not torch.equal(drawn[0]["path"], drawn[2]["path"])
    env = make_env("kinematic", task=random_task(), batch_size=(16,))
    env.set_seed(1)
    env.set_seed(None)
    torch.manual_seed(5)
    assert (starts(env) == drawn[0]).all()


def test_a_seed_reaches_through_what_is_put_around_the_environment():
    task = random_task()
    drawn = []
    for _ in range(2):
        inner = make_env("kinematic", task=task, batch_size=(4,))
        around = TransformedEnv(inner, RewardSum())
        drawn.append(starts(around, seed=3))
        several = SerialEnv(2, lambda: make_env("kinematic", task=task, batch_size=(4,)))
        drawn.append(starts(several, seed=3))
        several.close()
    assert (drawn[0] == drawn[2]).all()
    assert (drawn[1] == drawn[3]).all()
    assert not torch.equal(drawn[1]["path"][:, 0], drawn[1]["path"][:, 1])


def test_a_collector_keeps_terminated_and_truncated_apart_through_resets():
    torch.manual_seed(0)
    stack = changed(
        step_limit=TransformConfig("step_limit", {"max_steps": 40}),
        leave_path=TransformConfig("leave_path", {"limit": 0.05}),
    )
    env = make_env("kinematic", task=stack, batch_size=(16,))

    def policy(state):  # half of the cars drive off at full lock, the others do not move
        action = torch.tensor([[1.0, 1.0], [-1.0, 0.0]]).repeat(8, 1)
        return state.set(keys.ACTION, action)

    frames = 16 * 100
    collector = Collector(
        env, policy, frames_per_batch=frames, total_frames=frames, trust_policy=True
    )
    (batch,) = list(collector)
    collector.shutdown()
    after = batch["next"]
    ended = after[keys.TERMINATED] | after[keys.TRUNCATED]
    assert torch.equal(after[keys.DONE], ended)
    assert not after[keys.TERMINATED][1::2].any()
    # the standing ones: at steps 40 and 80
    assert after[keys.TRUNCATED][1::2].sum(1).flatten().tolist() == [2] * 8
    far = after[task.LATERAL_ERROR].abs() > 0.05
    assert torch.equal(after[keys.TERMINATED], far)
    assert far.any()
    # after an end the next row begins a new episode, before it is the true last one
    follows = ended[:, :-1]
    assert (batch["step_count"][:, 1:][follows] == 0).all()
    assert (batch[task.NEXT_WAYPOINT][:, 1:][follows] == 1).all()
    assert (after["step_count"][:, :-1][follows] > 0).all()
    assert torch.equal(
        batch[task.OBSERVATION][:, 1:][~follows[..., 0]],
        after[task.OBSERVATION][:, :-1][~follows[..., 0]],
    )


def test_yaml_swaps_a_transform(tmp_path):
    file = tmp_path / "task.yaml"
    file.write_text(
        "paths: {count: 5, waypoints: 60}\n"
        "transforms:\n"
        "  filter: {name: past_mean, options: {width: 3}}\n"
        "  history: {name: history, options: {rows: 2}}\n"
    )
    env = make_env("kinematic", task=build(TaskConfig, [str(file)]))
    kinds = [type(t) for t in env.transform]
    assert PastMean in kinds
    assert History in kinds
    assert env.observation_spec[task.OBSERVATION].shape == (46,)
    assert len(kinds) == len(make_env("kinematic", task=FEW).transform) + 2


def test_the_example_config_builds_and_drives(repository):
    file = str(repository / "configs" / "task_waypoints.yaml")
    config = build(TaskConfig, [file, "paths.count=4", "paths.waypoints=60"])
    env = make_env("single_track", task=config, batch_size=3)
    check_env_specs(env)
    assert any(isinstance(t, RateLimit) for t in env.transform)
    assert env.observation_spec[task.REWARD_TERMS].shape == (3, 3)


def test_the_example_in_the_docstring_runs(repository, monkeypatch, capsys):
    monkeypatch.chdir(repository)
    doc = buggy_rl.task.env.__doc__ or ""
    lines = [line[4:] for line in doc.splitlines() if line.startswith("    ")]
    assert len(lines) == 5
    lines[2] = lines[2].replace('"transforms', '"paths.count=4", "transforms')  # for speed
    space = {}
    exec("\n".join(lines), space)
    assert not any(isinstance(t, RateLimit) for t in space["env"].transform)
    assert math.isfinite(float(capsys.readouterr().out.removeprefix("tensor(").split(")")[0]))


def test_torchrls_own_transforms_can_be_named():
    frames = TransformConfig(
        "torchrl.envs:CatFrames",
        {"N": 3, "dim": -1, "in_keys": [task.OBSERVATION], "out_keys": [task.OBSERVATION]},
    )
    env = make_env("kinematic", task=changed(history=frames), batch_size=(4,))
    check_env_specs(env)
    assert env.observation_spec[task.OBSERVATION].shape == (4, 69)


def test_ones_own_transform_comes_from_a_file_and_stands_where_it_is_told(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(
        "from buggy_rl.task.transforms.base import TaskTransform\n"
        "class Loud(TaskTransform):\n"
        "    def __init__(self, dt, loudness=1.0):\n"
        "        super().__init__()\n"
        "        self.dt, self.loudness = dt, loudness\n"
    )
    own = TransformConfig(f"{file}:Loud", {"loudness": 2.0}, before="observation")
    env = make_env("kinematic", task=changed(mine=own))
    names = [type(t).__name__ for t in env.transform]
    assert names.index("Loud") == names.index("Observation") - 1
    loud = env.transform[names.index("Loud")]
    assert (loud.dt, loud.loudness) == (0.01, 2.0)


class HalfThrottle(Transform):
    """Missing physics, to the eye of the task."""

    def _inv_call(self, tensordict):
        throttle, steering = tensordict[keys.ACTION].unbind(-1)
        drive = (throttle + 1) / 2
        return tensordict.set(keys.ACTION, torch.stack([drive - 1, steering], -1))


def test_effects_stand_between_the_engine_and_the_task():
    env = make_env("kinematic", effects=[HalfThrottle()], task=FEW)
    plain = make_env("kinematic", task=FEW)
    assert isinstance(env.transform[0], HalfThrottle)
    assert type(env.base_env) is type(plain.base_env)

    def speed(which, throttle):
        state = which.reset()
        for _ in range(20):
            state = which.step(state.set(keys.ACTION, torch.tensor([throttle, 0.0])))["next"]
        assert state[task.LAST_ACTION].tolist() == [throttle, 0.0]  # the task knows no effect
        return state[keys.VELOCITY]

    assert torch.equal(speed(env, 1.0), speed(plain, 0.0))


def test_a_simulator_that_has_transforms_gets_one_stack_and_no_warning():
    inner = TransformedEnv(make("kinematic", (3,)), Compose(HalfThrottle()))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = make_env(inner, task=FEW)
    check_env_specs(env)
    assert not isinstance(env.base_env, TransformedEnv)
    assert isinstance(env.transform[0], HalfThrottle)
    assert len(inner.transform) == 1  # the simulator itself is as it was


@pytest.mark.parametrize(
    ("places", "message"),
    [
        (
            {"filter": TransformConfig("past_man")},
            "no transform 'past_man'; did you mean 'past_mean'\\? available: last_act",
        ),
        (
            {"filter": TransformConfig("past_mean", {"widht": 3})},
            "'past_mean' has no option widht; available: width",
        ),
        ({"mine": TransformConfig("history", before="nowhere")}, "'mine' stands before 'nowhere'"),
        ({"noise": TransformConfig(), "late": TransformConfig("observation_noise")}, "too late"),
        ({"waypoints": TransformConfig()}, "nothing before it writes waypoints"),
        (
            {"leave_path": TransformConfig(), "late": TransformConfig("leave_path")},
            "LeavePath comes too late",
        ),
        ({"last_action": TransformConfig()}, None),
        (
            {
                "last_action": TransformConfig(),
                "rewards": TransformConfig("rewards", {"weights": {"steering_effort": 1.0}}),
            },
            "Rewards reads last_action",
        ),
    ],
)
def test_a_stack_that_cannot_work_is_refused_when_it_is_built(places, message):
    if message is None:
        make_env("kinematic", task=changed(**places))
        return
    with pytest.raises(ValueError, match=message):
        make_env("kinematic", task=changed(**places))


def test_options_of_a_place_without_a_transform_are_refused():
    with pytest.raises(ValueError, match="options bias are given to a place without a transform"):
        build(TaskConfig, ["transforms.mine.options.bias=0.3"])


def test_an_unknown_option_of_the_task_is_refused():
    with pytest.raises(ConfigError, match=r"unknown key 'transforms\.filter\.nam'"):
        build(TaskConfig, ["transforms.filter.nam=past_mean"])


def test_places_of_ones_own_go_where_they_say():
    transforms = {
        "a": TransformConfig("first"),
        "b": TransformConfig("second"),
        "c": TransformConfig("between", before="b"),
        "d": TransformConfig("last"),
        "e": TransformConfig(),
    }
    assert [c.name for c in transforms_in_order(transforms)] == [
        "first",
        "between",
        "second",
        "last",
    ]


def test_a_file_without_the_class_is_refused(tmp_path):
    file: Path = tmp_path / "empty.py"
    file.write_text("")
    with pytest.raises(ValueError, match="has no 'Loud'"):
        make_transform(f"{file}:Loud")
    with pytest.raises(ValueError, match=r"there is no file nowhere\.py"):
        make_transform("nowhere.py:Loud")


def test_the_step_limit_is_torchrls():
    assert isinstance(make_env("hold", task=FEW).transform[-1], StepCounter)
