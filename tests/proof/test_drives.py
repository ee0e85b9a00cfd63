"""Drives of cases: each by its own driver, each nuisance does what it says and nothing else."""

from functools import cache

import pytest
import torch
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.policies.controllers.room import RoomDriver
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.drives import (
    DRIVERS,
    SPEED,
    SteadyDriver,
    drive_cases,
    plant_parameters,
    true_drive,
)
from buggy_rl.proof.cases.simulators import (
    DROPPED,
    JITTER,
    correlated,
    recorded_case_drive,
    save_drives,
)
from buggy_rl.recordings import load_recordings
from buggy_rl.recordings.camera import CameraConfig
from buggy_rl.simulators import make_engine

CARS, ROWS, SETTLED = 3, 900, 300
LONG = 6000


@cache
def drive(kind):
    driver = kind(seed=4)
    return true_drive(make_engine("kinematic", CARS), driver, driver.start_pose([CARS]), ROWS)


@pytest.fixture(scope="module")
def steady():
    return drive(SteadyDriver)


@pytest.mark.slow
def test_a_steady_driver_holds_one_speed(steady):
    speed = steady[keys.VELOCITY][:, SETTLED:, 0]
    # The driver believes in more friction than this car has.
    assert float(speed.median()) == pytest.approx(SPEED, abs=0.5)
    rich = drive(RoomDriver)[keys.VELOCITY][:, SETTLED:, 0]
    assert float(speed.std()) < 0.5 * float(rich.std())


@pytest.mark.slow
def test_a_steady_driver_stays_in_the_room_and_does_not_jerk(steady):
    assert float(steady[keys.POSE][..., :2].abs().max()) < 4.0
    steering = steady[keys.ACTION][..., 1]
    # Away from the walls, where bends are wide; the slalom's fastest is 0.35 * 2 pi / 9 s.
    moved = steering.diff(dim=1).abs()
    assert float(moved.median()) < 0.35 * 2 * torch.pi / 9 * 0.01


def test_the_car_before_the_change_has_nothing_wrong_with_it():
    slow = {"throttle_gain": {"gain": 0.75}}
    cases = [
        Case(6, "reference", "mujoco_fitted", True, concealed, seconds=1.5)
        for concealed in ({}, slow)
    ]
    right, wrong = drive_cases(cases)
    assert right.clean is not None
    assert wrong.clean is not None
    assert torch.equal(right.clean[keys.POSE], wrong.clean[keys.POSE])
    assert not torch.equal(right.changed[keys.POSE], wrong.changed[keys.POSE])
    assert drive_cases([Case(6, "reference", "reference", seconds=1.0)])[0].clean is None


def test_baseline_drives_are_other_drives():
    motion = drive_cases([Case(6, "reference", "mujoco_fitted", True, seconds=1.0)])[0]
    assert motion.clean is not None
    assert motion.changed.shape == (3, 100)
    assert motion.clean.shape == (2, 100)
    assert not torch.equal(motion.clean[keys.POSE], motion.changed[:2][keys.POSE])


@pytest.fixture(scope="module")
def true():
    """A car that stands still, and whose command is the number of its row."""
    action = torch.arange(LONG).float().unsqueeze(-1).expand(LONG, 2) / LONG
    still = torch.zeros(LONG, 3)
    motion = {keys.POSE: still, keys.VELOCITY: still.clone(), keys.ACTION: action}
    return TensorDict(motion, [LONG])


def shown(true, nuisance, seed=3, **concealed):
    case = Case(seed, "reference", "reference", concealed=concealed, nuisance=nuisance)
    return recorded_case_drive(case, true, True, 0).data


def autocorrelation(noise):
    noise = noise - noise.mean(0)
    return float((noise[1:] * noise[:-1]).sum() / noise.square().sum())


@pytest.mark.parametrize(("nuisance", "rho"), [("white", 0.0), ("coloured", 0.9)])
def test_noise_has_the_colour_it_should_have_and_the_cameras_size(true, nuisance, rho):
    data = shown(true, nuisance)
    assert autocorrelation(data[keys.VELOCITY][:, :1]) == pytest.approx(rho, abs=0.04)
    # Of AR(1) noise, 6000 rows are worth 6000 (1 - .9) / (1 + .9) = 316: 4 % a standard error.
    assert float(data[keys.VELOCITY][:, 0].std()) == pytest.approx(
        CameraConfig().velocity_noise, rel=0.15
    )
    assert float(data[keys.POSE][:, 2].std()) == pytest.approx(CameraConfig().yaw_noise, rel=0.15)


def test_coloured_noise_is_as_large_in_its_first_row_as_in_any_other():
    first = torch.stack([correlated(2, 1, seed)[0] for seed in range(2000)])
    assert float(first.std()) == pytest.approx(1.0, abs=0.07)


def test_thrice_is_three_times(true):
    ratio = shown(true, "thrice")[keys.VELOCITY].std(0) / shown(true, "white")[keys.VELOCITY].std(0)
    assert ratio.tolist() == pytest.approx([3.0, 3.0, 3.0], rel=1e-3)


def test_commands_are_one_sample_off_in_either_direction(true):
    right = shown(true, "white")[keys.ACTION][1:-1]
    directions = set()
    for seed in range(12):
        moved = shown(true, "stamps", seed)[keys.ACTION][1:-1] - right
        steps = (moved * LONG).round()
        assert steps.abs().unique().tolist() == [1.0]
        directions.add(float(steps[0, 0]))
        assert steps.unique().numel() == 1
    assert directions == {-1.0, 1.0}


def test_stamps_jitter_by_a_millisecond_and_stay_in_order(true):
    time = shown(true, "jitter")[keys.TIME][:, 0]
    off = time - shown(true, "white")[keys.TIME][:, 0]
    assert float(off.std()) == pytest.approx(JITTER, rel=0.05)
    assert bool((time.diff() > 0).all())


def test_frames_are_dropped_in_their_share(true):
    lost = 1 - len(shown(true, "dropped")) / LONG
    assert DROPPED / 3 < lost < 3 * DROPPED


def test_before_the_change_the_camera_is_right(true):
    concealed = {"gyro_bias": {"bias": 0.5}}
    case = Case(3, "reference", "reference", True, concealed)
    rate = [
        float(recorded_case_drive(case, true, c, 0).data[keys.VELOCITY][:, 2].mean())
        for c in (0, 1)
    ]
    assert rate == pytest.approx([0.0, 0.5], abs=0.005)


def test_two_drives_of_a_case_have_two_noises(true):
    case = Case(3, "reference", "reference")
    one, other = (recorded_case_drive(case, true, True, place).data for place in (0, 1))
    assert not torch.equal(one[keys.POSE], other[keys.POSE])


def test_drives_are_saved_with_the_noise_of_their_numbers(true, tmp_path):
    case = Case(3, "reference", "reference")
    two = TensorDict.stack([true[:200], true[:200]])
    save_drives(case, two, tmp_path / "deep", {"a": 7, "b": 8})
    found = {r.name: r.data[keys.POSE] for r in load_recordings([str(tmp_path / "deep")])[0]}
    for name, number in (("a", 7), ("b", 8)):
        expected = recorded_case_drive(case, true[:200], True, number).data[keys.POSE]
        torch.testing.assert_close(found[name], expected, atol=1e-6, rtol=0)


def test_composed_physics_moves_the_car_behind_the_drivers_back():
    push = {"yaw.time.saturating.none": {"size": 9.0}}
    cases = [
        Case(6, "reference", "reference", True, concealed, seconds=1.5) for concealed in ({}, push)
    ]
    right, wrong = drive_cases(cases)
    assert right.clean is not None
    assert wrong.clean is not None
    assert torch.equal(right.clean[keys.POSE], wrong.clean[keys.POSE])
    assert not torch.equal(right.changed[keys.POSE], wrong.changed[keys.POSE])
    # The other case of the batch does not feel it.
    alone = drive_cases(cases[:1])[0]
    torch.testing.assert_close(alone.changed[keys.POSE], right.changed[keys.POSE])


def test_what_disturbs_a_command_is_not_in_the_log():
    trim = {"steering.time.saturating.none": {"size": 0.3}}
    cases = [Case(6, "reference", "reference", seconds=1.0, concealed=c) for c in ({}, trim)]
    plain, off = drive_cases(cases)
    # The driver has seen nothing of it yet.
    assert torch.equal(plain.changed[keys.ACTION][:, :5], off.changed[keys.ACTION][:, :5])
    assert not torch.equal(plain.changed[keys.POSE], off.changed[keys.POSE])


def test_what_disturbs_the_sensor_is_in_the_record_and_not_in_the_motion(true):
    drift = {"seen_yaw.time.linear.none": {"size": 0.06}}
    case = Case(6, "reference", "reference", concealed=drift)
    plain, off = recorded_case_drive(case, true, False, 0), recorded_case_drive(case, true, True, 0)
    added = (off.data[keys.POSE] - plain.data[keys.POSE])[:, 2]
    assert float(added[-1]) == pytest.approx(0.06 * LONG * 0.01 / 30.0, rel=1e-2)
    assert torch.equal(plain.data[keys.VELOCITY], off.data[keys.VELOCITY])


def test_a_plant_of_drawn_parameters_is_another_car_and_the_same_for_one_seed():
    case = Case(6, "reference", "reference", seconds=1.5, spread=0.1)
    assert plant_parameters(case) == plant_parameters(case) != {}
    assert not plant_parameters(Case(6, "reference", "reference"))
    own, usual = (
        drive_cases([c])[0] for c in (case, Case(6, "reference", "reference", seconds=1.5))
    )
    assert not torch.equal(own.changed[keys.POSE], usual.changed[keys.POSE])
    # In one batch with the other, each is the car that it is alone.
    both = drive_cases([case, Case(6, "reference", "reference", seconds=1.5)])
    torch.testing.assert_close(both[0].changed[keys.POSE], own.changed[keys.POSE])
    torch.testing.assert_close(both[1].changed[keys.POSE], usual.changed[keys.POSE])


@pytest.mark.slow
def test_hands_differ():
    seen = {name: drive(kind)[keys.VELOCITY][:, SETTLED:] for name, kind in DRIVERS.items()}
    assert float(seen["timid"][..., 0].mean()) < float(seen["rich"][..., 0].mean())
    assert float(seen["wild"][..., 0].mean()) > float(seen["timid"][..., 0].mean())


def test_a_rally_drive_is_recorded_as_its_misled_sensor_shows_it():
    drives = []
    for size in (0.0, 0.5):  # the share of the floor where the tracker holds its last pose
        case = Case(5, "rally", "learned", concealed={"glare_hold": {"size": size}}, seconds=3.0)
        drives.append(drive_cases([case])[0].changed)
    plain, held = (drive[keys.POSE][..., :2].diff(dim=1).norm(dim=-1) for drive in drives)
    moving = plain > 0.005  # [m] a row
    assert moving.float().mean() > 0.2
    assert (held[moving] == 0).float().mean() > 0.1
    assert not (plain[moving] == 0).any()
    assert torch.equal(drives[0][keys.ACTION], drives[1][keys.ACTION])  # the driver sees the car
