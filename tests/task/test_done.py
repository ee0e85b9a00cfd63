"""done = terminated or truncated, whatever simulator and transforms say of an episode's end."""

import random

import gymnasium
import pytest
import torch
from torchrl.data import Binary

from buggy_rl.core import keys
from buggy_rl.simulators import make_engine
from buggy_rl.task.config import TaskConfig, TransformConfig, default_transforms
from buggy_rl.task.env import make_env
from buggy_rl.task.gym import WaypointsEnv
from buggy_rl.task.paths.making import PathConfig, make_paths
from tests import plain_env
from tests.contracts.test_engines import make

PATHS = make_paths(PathConfig(count=3, waypoints=12))
FLAGS = (keys.DONE, keys.TERMINATED, keys.TRUNCATED)


class Ending(plain_env.QuickCar):
    """A simulator whose episodes end by themselves, once its motor's force has passed 4 N.

    Args:
        says: Flags that it raises then.
        declares: Flags that are in its specs, beside done and terminated.
    """

    def __init__(self, batch_size, says=(), declares=(keys.TRUNCATED,)):
        self._said = says
        super().__init__(batch_size)
        done = self.full_done_spec.clone()
        for key in declares:
            done[key] = Binary(1, shape=(*self.batch_size, 1), dtype=torch.bool)
        self.full_done_spec = done

    def _step(self, tensordict):
        after = super()._step(tensordict)
        over = after["motor_force"] > 4.0
        for key in self.full_done_spec.keys():  # noqa: SIM118  a Composite has no `in`
            after[key] = over if key in self._said else torch.zeros_like(over)
        return after


def stack_of(*endings, limit=9):
    """The default task with only these endings."""
    options = {"step_limit": {"max_steps": limit}, "leave_path": {"limit": 0.02}}
    return TaskConfig(
        transforms={
            place: TransformConfig(place, options[place])
            if place in options and place in endings
            else TransformConfig()
            if place in ("step_limit", "leave_path", "path_end") and place not in endings
            else config
            for place, config in default_transforms().items()
        }
    )


def said(env, seed, steps=25):
    """Flags [steps] of a drive at full throttle, which begins anew where an episode ends."""
    torch.manual_seed(seed)
    env.set_seed(seed)
    state, rows = env.reset(), []
    generator = torch.Generator().manual_seed(seed)
    for _ in range(steps):
        action = torch.rand(*env.batch_size, 2, generator=generator) * 2 - 1
        state[keys.ACTION] = action.index_fill(-1, torch.tensor([0]), 1.0)
        data, state = env.step_and_maybe_reset(state)
        rows.append(data["next"].select(*FLAGS, strict=False))
        assert not any(state[key].any() for key in env.done_keys)
    return torch.stack(rows)


@pytest.mark.parametrize("seed", range(24))
def test_done_is_terminated_or_truncated_in_any_stack(seed):
    draw = random.Random(seed)
    endings = [e for e in ("leave_path", "path_end", "step_limit") if draw.random() < 0.5]
    says = [flag for flag in FLAGS if draw.random() < 0.5]
    declares = [keys.TRUNCATED] if keys.TRUNCATED in says or draw.random() < 0.5 else []
    own = make("kinematic", (3,)) if draw.random() < 0.3 else Ending(3, says, declares)
    env = make_env(own, task=stack_of(*endings), paths=PATHS)
    rows = said(env, seed)
    truncated = rows.get(keys.TRUNCATED, torch.zeros_like(rows[keys.DONE]))
    assert torch.equal(rows[keys.DONE], rows[keys.TERMINATED] | truncated)
    if isinstance(own, Ending):
        assert bool(rows[keys.DONE].any()) or not (says or endings)


@pytest.mark.parametrize(
    ("says", "terminated", "truncated"),
    [
        ([keys.TRUNCATED], False, True),
        ([keys.TRUNCATED, keys.DONE], False, True),
        ([keys.TERMINATED], True, False),
        ([keys.DONE], True, False),  # for no reason: it counts as a failure
        ([keys.TERMINATED, keys.TRUNCATED], True, True),
    ],
)
@pytest.mark.parametrize("endings", [(), ("path_end",), ("path_end", "leave_path", "step_limit")])
def test_what_a_simulator_says_ends_an_episode_of_gymnasium(says, terminated, truncated, endings):
    task = stack_of(*endings, limit=500)
    wide = {**task.transforms}
    if "leave_path" in endings:
        wide["leave_path"] = TransformConfig("leave_path", {"limit": 50.0})
    env = WaypointsEnv(Ending((), says), task=TaskConfig(transforms=wide), paths=PATHS)
    assert isinstance(env, gymnasium.Env)
    env.reset(seed=0)
    for _ in range(20):
        _, _, failed, cut, _ = env.step([1.0, 0.0])
        if failed or cut:
            break
    assert (failed, cut) == (terminated, truncated)


def test_an_engine_ends_nothing():
    rows = make_engine("kinematic", 3).rollout(4)["next"]
    assert not rows[keys.DONE].any()
    assert not rows[keys.TERMINATED].any()
