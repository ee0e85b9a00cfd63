import math

import pytest
import torch

from buggy_rl.core import keys
from buggy_rl.policies.closed_loop import drive
from buggy_rl.simulators.base import HoldEngine
from buggy_rl.task.config import TaskConfig, TransformConfig, default_transforms
from buggy_rl.task.env import make_env
from buggy_rl.task.paths.making import PathConfig

STEPS = 100


class Rolling(HoldEngine):
    """Cars that roll on for ever at 1 m/s, 0.3 m to the left of where they were put."""

    def _rest_latent(self, pose, velocity):
        return {
            keys.POSE: pose + torch.tensor([0.0, 0.3, 0.0]),
            keys.VELOCITY: torch.tensor([1.0, 0.0, 0.0]).expand_as(velocity).clone(),
        }


def environment(tmp_path, limit: float, car=Rolling):
    file = tmp_path / "straight.csv"
    rows = "\n".join(f"{0.2 * i:.1f},0.0" for i in range(40))
    file.write_text(f"x,y\n{rows}\n")
    stack = default_transforms()
    stack["leave_path"] = TransformConfig("leave_path", {"limit": limit})
    stack["waypoints"] = TransformConfig("waypoints", {"order": "fixed"})
    task = TaskConfig(paths=PathConfig(kind="file", file=str(file)), transforms=stack)
    return make_env(car(2), task=task)


def coasting(state):
    return state.set(keys.ACTION, torch.tensor([-1.0, 0.5]).expand(2, 2))


def test_scores_are_those_computed_by_hand(tmp_path):
    scores = drive(environment(tmp_path, limit=1.0), coasting, STEPS)
    # 1 m in 1 s: the waypoints at 0.2, 0.4, 0.6 and 0.8 m are passed for sure, 1.0 m just about.
    assert set(scores.waypoints.tolist()) <= {4.0, 5.0}
    for name in ("lateral_mean", "lateral_rms", "lateral_max"):
        assert getattr(scores, name).tolist() == pytest.approx([0.3, 0.3], abs=1e-4)
    assert scores.speed.tolist() == pytest.approx([1.0, 1.0])
    assert scores.heading_mean.tolist() == pytest.approx([0.0, 0.0], abs=1e-6)
    # One change of the steering command, from 0 to 0.5, in 100 steps.
    assert scores.steering_effort.tolist() == pytest.approx([0.005, 0.005])
    assert scores.kept_on.tolist() == [1.0, 1.0]
    assert all(math.isnan(share) for share in scores.out_of_range.tolist())


class Turning(Rolling):
    """Turns on the spot."""

    yaw_rate = 0.0  # [rad/s]

    def _rest_latent(self, pose, velocity):
        turning = torch.tensor([0.0, 0.0, self.yaw_rate])
        return {**super()._rest_latent(pose, velocity), keys.VELOCITY: turning.expand(2, 3).clone()}


@pytest.mark.parametrize(("yaw_rate", "spun"), [(1.5, 0.0), (-1.7, 1.0)])
def test_a_car_that_turns_by_more_than_90_degrees_has_spun(tmp_path, yaw_rate, spun):
    env = environment(tmp_path, limit=1.0, car=Turning)
    env.base_env.yaw_rate = yaw_rate  # a second is driven
    assert drive(env, coasting, STEPS).spun.tolist() == [spun, spun]


def test_what_a_car_does_after_it_left_its_path_does_not_count(tmp_path):
    scores = drive(environment(tmp_path, limit=0.2), coasting, STEPS)
    assert scores.kept_on.tolist() == pytest.approx([1 / STEPS, 1 / STEPS])
    assert scores.waypoints.tolist() == [0.0, 0.0]
