from dataclasses import dataclass, field

import pytest
import torch
from tensordict.nn import TensorDictModule

from buggy_rl.policies.controllers.path_tracking import PurePursuit, PurePursuitConfig
from buggy_rl.policies.controllers.tuning import Number, TuningConfig, tune, within
from tests.policies.controllers.test_followers import course


@dataclass(frozen=True)
class Commands:
    throttle: Number = field(default=-1.0, metadata=within(-1.0, 1.0))
    steering: Number = field(default=0.0, metadata=within(-0.5, 0.5))
    label: str = "not a number to be tuned"


def constant(config):
    """Drives with the same commands always; on a straight of 2 m, faster is better."""

    def commands(velocity):
        shape = velocity.shape[:-1]
        parts = [torch.as_tensor(c).expand(shape) for c in (config.throttle, config.steering)]
        return torch.stack(parts, -1)

    return TensorDictModule(commands, ["velocity"], ["action"])


def test_the_search_finds_what_is_best_and_shows_what_it_tried():
    env = course("lap", cars=12)
    best, trials = tune(env, 1, constant, Commands(), TuningConfig(120, 3, 0.5))
    assert len(trials) == 36
    assert best.throttle > 0  # from -1: fast, but not out of the first bend
    assert abs(best.steering) < 0.1
    assert (best.throttle, best.steering) == tuple(trials[0].values.values())
    assert trials[0].waypoints == max(t.waypoints for t in trials if t.lateral_rms <= 0.5)
    assert all(-1 <= t.values["throttle"] <= 1 for t in trials)
    assert best.label == Commands().label


def test_what_is_found_is_never_worse_than_what_was_given():
    env = course("lap", "infinity", cars=3)
    given = PurePursuitConfig()
    _, trials = tune(env, 2, PurePursuit, given, TuningConfig(150, 1, 0.3))
    tried = [t for t in trials if abs(t.values["full_lock"] - given.full_lock) < 1e-6]
    assert len(tried) == 1
    assert trials[0].waypoints >= tried[0].waypoints
    assert set(trials[0].values) >= {"shortest", "speed.top_speed"}


def test_when_all_stray_the_one_that_strays_least_is_taken():
    env = course("infinity", cars=8)
    _, trials = tune(env, 1, constant, Commands(throttle=1.0), TuningConfig(150, 1, 1e-4))
    assert trials[0].lateral_rms == min(t.lateral_rms for t in trials)


def test_one_seed_is_one_search():
    env = course("lap", cars=4)
    runs = [tune(env, 1, constant, Commands(), TuningConfig(60, 2, seed=s))[1] for s in (0, 0, 1)]
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


def test_cars_that_cannot_be_shared_out_are_refused():
    with pytest.raises(ValueError, match="4 cars on 3 paths"):
        tune(course("lap", cars=4), 3, constant, Commands(), TuningConfig())
