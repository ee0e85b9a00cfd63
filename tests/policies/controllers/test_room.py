import pytest
import torch
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.policies.controllers.recording import RecordConfig
from buggy_rl.policies.controllers.room import RoomConfig, RoomDriver
from buggy_rl.simulators import make_engine

NOSE = 0.14  # [m] half the car's length, rounded up


@torch.no_grad()
def drives(cars=48, seconds=20, seed=0, simulator="reference"):
    """Rows [T, cars] of pose, velocity and action."""
    engine, driver = make_engine(simulator, cars), RoomDriver(seed=seed)
    pose = driver.start_pose((cars,))
    start = {keys.POSE: pose, keys.VELOCITY: torch.zeros_like(pose)}
    state, rows = engine.reset(TensorDict(start, [cars]), set_state=True), []
    for _ in range(round(100 * seconds)):
        state = driver(state)
        rows.append(state.select(keys.POSE, keys.VELOCITY, keys.ACTION).clone())
        state = engine.step(state)["next"]
    return torch.stack(rows)


@pytest.fixture(scope="module")
def driven():
    return drives()


@pytest.mark.slow
def test_the_room_driver_never_touches_a_wall(driven):
    assert driven[keys.POSE][..., :2].abs().max() < 4.0 - NOSE


@pytest.mark.slow
@pytest.mark.parametrize("simulator", ["reference", "single_track", "kinematic"])
def test_the_room_driver_never_touches_a_wall_with_hundreds_of_seeds(simulator):
    for seed in range(3):
        rows = drives(256, 60, seed, simulator)
        assert rows[keys.POSE][..., :2].abs().max() < 4.0 - NOSE


def test_every_drive_starts_from_rest_and_stands_a_moment(driven):
    assert (driven[keys.VELOCITY][:20, :, :2].abs() < 1e-6).all()
    assert (driven[keys.ACTION][:30, :, 0] == -1).all()


def test_the_drives_cover_speeds_throttles_and_steering_angles(driven):
    vx, throttle, steering = (
        driven[keys.VELOCITY][..., 0].flatten(),
        driven[keys.ACTION][..., 0].flatten(),
        driven[keys.ACTION][..., 1].flatten(),
    )
    for low, high, share in ((0.2, 1.0, 0.08), (1.0, 2.0, 0.2), (2.0, 3.0, 0.15), (3.0, 4.0, 0.01)):
        assert ((vx > low) & (vx < high)).float().mean() > share, (low, high)
    assert (vx < 3.9).all()
    for low, high, share in (
        (-1.01, -0.99, 0.1),
        (-0.7, 0.0, 0.3),
        (0.0, 0.6, 0.05),
        (0.6, 1, 0.01),
    ):
        assert ((throttle > low) & (throttle <= high)).float().mean() > share, (low, high)
    histogram = torch.histc(steering, 10, -1, 1) / steering.numel()
    assert histogram.min() > 0.03
    assert abs(float((steering > 0).float().mean()) - 0.5) < 0.05  # both directions


def test_each_single_drive_has_rest_motion_coasting_and_both_turns(driven):
    speed, yaw_rate = driven[keys.VELOCITY][..., 0], driven[keys.VELOCITY][..., 2]
    coasting = (driven[keys.ACTION][..., 0] == -1) & (speed > 0.5)
    assert ((speed > 1.5).float().mean(0) > 0.02).float().mean() > 0.9
    assert (coasting.sum(0) > 20).float().mean() > 0.9
    assert ((yaw_rate > 1).any(0) & (yaw_rate < -1).any(0)).float().mean() > 0.9


def test_the_tail_does_not_come_round(driven):
    vx, vy, _ = driven[keys.VELOCITY].unbind(-1)
    assert (torch.atan2(vy, vx.clamp_min(0.5)).abs() > 0.6).float().mean() < 0.002


def test_one_seed_drives_one_way_and_leaves_the_global_state_alone():
    torch.manual_seed(5)
    one, same, other = (drives(3, 1.5, seed)[keys.ACTION] for seed in (1, 1, 2))
    drawn = torch.rand(1)
    torch.manual_seed(5)
    assert torch.equal(torch.rand(1), drawn)
    assert torch.equal(one, same)
    assert not torch.equal(one, other)


def test_commands_move_no_faster_than_a_thumb(driven):
    assert driven[keys.ACTION].abs().max() <= 1.0
    assert driven[keys.ACTION].diff(dim=0).abs().max() <= 25.0 * 0.01 + 1e-6


def facing_wall(distance, speed):
    """A car `distance` in front of the wall at x = 4, driving straight at it."""
    pose = torch.tensor([[4.0 - distance, 0.0, 0.0], [distance - 4.0, 1.0, torch.pi]])
    velocity = torch.tensor([[speed, 0.0, 0.0]]).expand(2, 3)
    return TensorDict({keys.POSE: pose, keys.VELOCITY: velocity}, [2])


def test_a_faster_car_turns_away_earlier():
    # At 2.5 m/s R = hypot(0.75, 6.25 / 5.5) = 1.36 m, and 0.5 m pass during the reaction: it must
    # turn from 1.36 + 0.5 + 0.3 = 2.16 m on; at 1 m/s from 0.77 + 0.2 + 0.3 = 1.27 m on.
    for speed, turns in ((2.5, 2.1), (1.0, 1.2)):
        for distance, expected in ((turns, True), (turns + 0.15, False)):
            driver = RoomDriver()
            driver(facing_wall(distance, speed))
            assert (driver.memory["side"] != 0).all() == expected, (speed, distance)


def test_near_a_wall_the_throttle_is_cut_and_the_wheel_goes_over():
    driver, state = RoomDriver(), facing_wall(1.5, 2.5)
    for _ in range(20):
        driver(state)
    assert (state[keys.ACTION][:, 0] < 0.1).all()
    assert (state[keys.ACTION][:, 1].abs() > 0.75).all()
    assert (state[keys.ACTION][:, 1].sign() == driver.memory["side"]).all()


def test_it_is_a_policy_for_a_rollout():
    rows = make_engine("kinematic", 2).rollout(200, policy=RoomDriver(seed=1))
    assert rows.shape == (2, 200)
    assert (rows["next", keys.VELOCITY][:, -1, 0] > 0.2).all()


@torch.no_grad()
def test_a_smaller_room_is_kept_too():
    engine, driver = make_engine("reference", 8), RoomDriver(RoomConfig(size=6.0), seed=3)
    state = engine.reset()
    for _ in range(500):
        state = engine.step(driver(state))["next"]
        assert state[keys.POSE][..., :2].abs().max() < 3.0 - NOSE


@pytest.mark.parametrize("wrong", [{"format": "xlsx"}, {"drives": 0}, {"seconds": 0.0}])
def test_impossible_recordings_are_refused(wrong):
    with pytest.raises(ValueError, match=str(next(iter(wrong.values())))):
        RecordConfig(output="x", **wrong)
