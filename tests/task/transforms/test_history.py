import pytest
import torch
from torchrl.envs import CatFrames, StepCounter

from buggy_rl.core import keys
from buggy_rl.core import keys as task
from buggy_rl.task.transforms.observation import History, Observation
from tests.task.transforms.cars import over_hold, start, step


def counting(*transforms, **options):
    """The observation is the car's x, which grows by 1 m a step at 100 m/s."""
    return over_hold(Observation([keys.POSE]), *transforms, **options)


def test_the_last_observations_stand_oldest_first():
    env = counting(History(3))
    state = start(env, velocity=(100.0, 0.0, 0.0))
    assert state[task.OBSERVATION][::3].tolist() == [0, 0, 0]  # all are the first one
    seen = []
    for _ in range(4):
        state = step(env, state)
        seen.append(state[task.OBSERVATION][::3].round().tolist())
    assert seen == [[0, 0, 1], [0, 1, 2], [1, 2, 3], [2, 3, 4]]


def test_it_is_torchrls_cat_frames_through_partial_resets():
    def observations(history):
        torch.manual_seed(0)
        env = counting(history, StepCounter(max_steps=5), batch_size=(3,))
        state = start(env, velocity=(100.0, 0.0, 0.0))
        state[task.STEP_COUNT] = torch.tensor([[0], [2], [4]])  # they end one after another
        rows = []
        for k in range(12):
            # a speed that differs from step to step and from car to car
            state[keys.VELOCITY] = torch.tensor([[1.0], [2.0], [3.0]]) * (k + 1) * torch.eye(3)[0]
            state[keys.ACTION] = torch.zeros(3, 2)
            data, state = env.step_and_maybe_reset(state)
            rows.append(torch.cat([data["next", task.OBSERVATION], state[task.OBSERVATION]], -1))
        return torch.stack(rows)

    frames = CatFrames(4, dim=-1, in_keys=[task.OBSERVATION], out_keys=[task.OBSERVATION])
    ours, theirs = observations(History(4)), observations(frames)
    assert ours.shape == (12, 3, 24)
    torch.testing.assert_close(ours, theirs, atol=0, rtol=0)


def test_a_history_of_nothing_is_refused():
    with pytest.raises(ValueError, match="rows is 0"):
        History(0)
