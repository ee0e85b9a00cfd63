import math

import pytest
import torch
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.core import keys as task
from buggy_rl.recordings.resampling import past_mean
from buggy_rl.task.transforms.observation import (
    ClipVelocity,
    Observation,
    ObservationNoise,
    PastMean,
    normal,
)
from buggy_rl.task.transforms.waypoints import Waypoints
from tests.task.transforms.cars import over_hold, start, step, straight_path


def test_what_is_shown_is_clipped_and_the_car_drives_on_as_it_did():
    env = over_hold(ClipVelocity())
    state = step(env, start(env, velocity=(9.0, -4.0, 7.0)))
    assert state[task.MEASURED_VELOCITY].tolist() == [3.5, -3.5, 6.5]
    assert state[keys.VELOCITY].tolist() == [9.0, -4.0, 7.0]
    assert step(env, state)[keys.VELOCITY].tolist() == [9.0, -4.0, 7.0]
    inside = start(env, velocity=(1.0, 2.0, -3.0))
    assert inside[task.MEASURED_VELOCITY].tolist() == [1.0, 2.0, -3.0]


@pytest.mark.parametrize("width", [1, 3, 5])
def test_the_past_mean_is_that_of_the_data_preparation(width):
    env = over_hold(PastMean(width), batch_size=(2,))
    generator = torch.Generator().manual_seed(0)
    velocity = torch.randn(12, 2, 3, generator=generator)
    state = start(env, velocity=(0.0, 0.0, 0.0), pose=(0.0, 0.0, 0.0))
    state = env.reset(
        TensorDict({keys.VELOCITY: velocity[0], keys.POSE: torch.zeros(2, 3)}, batch_size=[2]),
        set_state=True,
    )
    shown = [state[task.MEASURED_VELOCITY]]
    for row in velocity[1:]:
        state = step(env, state, velocity=row)
        shown.append(state[task.MEASURED_VELOCITY])
    for car in range(2):
        expected = past_mean(velocity[:, car], width)
        torch.testing.assert_close(torch.stack(shown)[:, car], expected)


def test_the_filter_sees_the_noise_and_not_the_clip():
    env = over_hold(PastMean(2), ClipVelocity())
    state = start(env, velocity=(2.0, 0.0, 0.0))
    state = step(env, state, velocity=(6.0, 0.0, 0.0))
    # mean of 2 and 6 is 4, then cut to 3.5; of the clipped ones it would be 2.75
    assert float(state[task.MEASURED_VELOCITY][0]) == 3.5


def test_normal_numbers_are_standard_normal_and_unrelated():
    drawn = normal(torch.arange(300_000).reshape(-1, 3))  # (100000, 6)
    assert drawn.isfinite().all()
    # standard errors: of a mean 0.0032, of a variance 0.0045, of a correlation 0.0032; five each
    assert (drawn.mean(0).abs() < 0.016).all()
    assert ((drawn.var(0) - 1).abs() < 0.023).all()
    within = torch.corrcoef(drawn.T) - torch.eye(6)
    assert (within.abs() < 0.016).all()
    onwards = torch.corrcoef(torch.stack([drawn[:-1, 0], drawn[1:, 0]]))[0, 1]
    assert abs(float(onwards)) < 0.016
    beyond = float((drawn.abs() > 3).float().mean())
    assert beyond == pytest.approx(math.erfc(3 / math.sqrt(2)), rel=0.15)  # 0.0027


def test_noise_has_the_deviation_asked_for_and_moves_no_car():
    torch.manual_seed(0)
    noise = ObservationNoise(position=0.01, yaw=0.02, velocity=0.3, yaw_rate=0.4)
    env = over_hold(noise, batch_size=(20_000,))
    state = step(env, start(env))
    assert not state[keys.POSE].any()
    assert not state[keys.VELOCITY].any()
    spread = torch.cat([state[task.MEASURED_POSE], state[task.MEASURED_VELOCITY]], -1).std(0)
    expected = torch.tensor([0.01, 0.01, 0.02, 0.3, 0.3, 0.4])
    torch.testing.assert_close(spread, expected, rtol=0.03, atol=0)  # six standard errors


def test_noise_is_new_in_each_step_and_each_episode_and_follows_the_seed():
    env = over_hold(ObservationNoise())

    def shown():
        state = start(env)
        rows = [state[task.MEASURED_VELOCITY]]
        for _ in range(3):
            state = step(env, state)
            rows.append(state[task.MEASURED_VELOCITY])
        return torch.stack(rows)

    torch.manual_seed(0)
    first, second = shown(), shown()
    torch.manual_seed(0)
    assert torch.equal(shown(), first)
    assert torch.cat([first, second]).unique(dim=0).shape[0] == 8


def test_a_noisy_pose_moves_the_waypoints_that_are_seen_but_closes_none():
    torch.manual_seed(0)
    env = over_hold(ObservationNoise(position=2.0, yaw=0.0), Waypoints(straight_path()))
    state = start(env)
    for _ in range(20):
        state = step(env, state)
        assert int(state[task.NEXT_WAYPOINT]) == 1
        seen = state[task.WAYPOINTS] + state[task.MEASURED_POSE][:2]
        torch.testing.assert_close(seen[0], torch.tensor([1.0, 0.0]))
    assert state[task.MEASURED_POSE][:2].abs().max() > 0.1


def test_the_observation_is_the_23_numbers_in_order():
    env = over_hold(Waypoints(straight_path()), Observation())
    state = start(env, velocity=(1.0, 2.0, 3.0))
    ahead = [number for x in range(1, 11) for number in (float(x), 0.0)]
    assert state[task.OBSERVATION].tolist() == [1.0, 2.0, 3.0, *ahead]


def test_the_observation_shows_the_measured_velocity():
    env = over_hold(ClipVelocity(), Waypoints(straight_path()), Observation())
    assert float(start(env, velocity=(9.0, 0.0, 0.0))[task.OBSERVATION][0]) == 3.5


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: ClipVelocity(low=(1.0, 0.0, 0.0), high=(0.0, 1.0, 1.0)), "must bound 3 numbers"),
        (lambda: ClipVelocity(low=(1.0,), high=(2.0,)), "must bound 3 numbers"),
        (lambda: PastMean(0), "width is 0"),
        (lambda: ObservationNoise(yaw=-0.1), "yaw is -0.1"),
        (lambda: Observation([]), "inputs is empty"),
    ],
)
def test_wrong_options_are_refused(build, message):
    with pytest.raises(ValueError, match=message):
        build()
