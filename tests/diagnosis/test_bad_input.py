"""Simulators and drives that are not fit to be compared, each refused or noted in one line."""

import re

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import ExcludeTransform, TransformedEnv
from torchrl.envs.utils import check_env_specs

from buggy_rl.core import keys
from buggy_rl.core.stepping import reset_at
from buggy_rl.diagnosis.answer.named_effect import check_clock
from buggy_rl.diagnosis.preflight import recordings as preflight
from buggy_rl.diagnosis.preflight import simulator as preflight_simulator
from buggy_rl.diagnosis.run.case import check_blocks, check_residuals
from buggy_rl.estimation.evidence import blocks
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import cut_segments
from buggy_rl.simulators import make_engine
from buggy_rl.simulators.bicycle.single_track import KinematicEngine
from buggy_rl.simulators.serial import in_single_precision
from tests.drives import counting_drive, toy_drive
from tests.plain_env import QuickCar


class Frozen(KinematicEngine):
    """Sets every car down at rest at the origin."""

    def _begin(self, given, rows):
        return super()._begin(given.empty(), rows)


class Stubborn(KinematicEngine):
    """Goes on from where it was, whatever velocity it is given."""

    def _advance(self, state, action):
        state = state.clone().set(keys.VELOCITY, torch.tensor([1.5, 0.0, 0.0]).expand(5, 3))
        return super()._advance(state, action)


class Random(KinematicEngine):
    """Draws noise that is not in the TensorDict."""

    def _advance(self, state, action):
        result = super()._advance(state, action)
        result[keys.VELOCITY] = result[keys.VELOCITY] + 0.01 * torch.randn(5, 3)
        return result


class Half(KinematicEngine):
    """Ignores the steering."""

    def _advance(self, state, action):
        return super()._advance(state, action * torch.tensor([1.0, 0.0]))


class Undefined(KinematicEngine):
    """Fails at full lock once it is fast."""

    def _advance(self, state, action):
        result = super()._advance(state, action)
        fast = (result[keys.VELOCITY][..., :1] > 2.0).expand(*action.shape[:-1], 3)
        nothing = torch.full_like(result[keys.VELOCITY], float("nan"))
        result[keys.VELOCITY] = torch.where(fast, nothing, result[keys.VELOCITY])
        return result


class Exploding(KinematicEngine):
    """Gains a tenth of its speed every step."""

    def _advance(self, state, action):
        result = super()._advance(state, action)
        return {**result, keys.VELOCITY: 1.1 * result[keys.VELOCITY]}


class Crashing(KinematicEngine):
    """Fails under full throttle."""

    def _advance(self, state, action):
        if bool((action[..., 0] > 0.9).any()):
            raise ZeroDivisionError("no current left\nand a second line")
        return super()._advance(state, action)


class Slow(KinematicEngine):
    """Steps twice as far as it says."""

    def _advance(self, state, action):
        halfway = super()._advance(state, action)
        return super()._advance(state.clone().update(halfway), action)


class Mixing(KinematicEngine):
    """Every car drags the others along."""

    def _advance(self, state, action):
        result = super()._advance(state, action)
        velocity = result[keys.VELOCITY]
        return {**result, keys.VELOCITY: 0.99 * velocity + 0.01 * velocity.mean(0)}


class Rounding(KinematicEngine):
    """Rounds its velocities to a hundredth."""

    def _advance(self, state, action):
        result = super()._advance(state, action)
        return {**result, keys.VELOCITY: (100 * result[keys.VELOCITY]).round() / 100}


class Jittering(KinematicEngine):
    """Rounds by the order in which it adds, which changes from step to step, as a GPU may."""

    def _advance(self, state, action):
        result = super()._advance(state, action)
        velocity = result[keys.VELOCITY]
        return {**result, keys.VELOCITY: velocity + 1e-7 * torch.randn_like(velocity)}


FAULTS = {
    Mixing: "another pose, velocity or command of one environment moved the others by",
    Frozen: "ignores the pose that reset was given",
    Stubborn: "does not honour an edited velocity: 1 more was",
    Random: "two steps from one TensorDict differ in 'velocity' .*: it is stochastic, it draws",
    Undefined: r"returns NaN 0\.\d\d s after 1.5 m/s under throttle 1, steering 0",
    Exploding: "runs away|control period|honour",
    Crashing: "a step raised ZeroDivisionError: no current left$",
    Slow: r"seems to have a control period of 0\.02\d* s",
}


@pytest.mark.parametrize("kind", FAULTS, ids=lambda kind: kind.__name__)
def test_a_faulty_simulator_is_refused_by_name_in_one_line(kind):
    with pytest.raises(ValueError, match=FAULTS[kind]) as told:
        preflight_simulator.check_simulator(kind, "my.py:make")
    assert "simulator my.py:make" in str(told.value)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("name", ["single_track", "kinematic"])
def test_a_sound_simulator_passes_without_a_note(name):
    assert preflight_simulator.check_simulator(lambda cars: make_engine(name, cars), name) == []


def test_steps_that_differ_by_rounding_are_equal():
    assert preflight_simulator.check_simulator(Jittering, "my.py:make") == []


def test_a_simulator_that_ignores_its_actions_is_refused_and_one_ignored_command_is_noted():
    with pytest.raises(ValueError, match="moves alike whatever the commands"):
        preflight_simulator.check_simulator(lambda cars: make_engine("hold", cars), "hold")
    notes = preflight_simulator.check_simulator(Half, "half")
    assert notes == [
        "simulator half moves alike whatever the steering: effects on it cannot be told"
    ]


def test_a_simulator_with_coarse_numbers_is_told_how_coarse():
    [note] = preflight_simulator.check_simulator(Rounding, "round")
    assert re.search(r"simulator round rounds its velocities by 0\.00[2-9] m/s", note)


@pytest.mark.parametrize("shape", [(), (1,)])
def test_a_single_environment_is_stepped_for_each_in_turn_and_noted(tmp_path, shape):
    file = tmp_path / "single.py"
    file.write_text(
        "from tests.plain_env import QuickCar\n"
        f"def make(batch_size, device='cpu'):\n    return QuickCar({shape}, device)\n"
    )
    name = f"{file}:make"
    one, many = make_engine(name, 5), in_single_precision(QuickCar(5))
    [note] = preflight_simulator.check_simulator(lambda count: make_engine(name, count), "single")
    assert "has one environment, which is stepped for each in turn" in note
    given = TensorDict({keys.VELOCITY: torch.rand(5, 3), keys.POSE: torch.rand(5, 3)}, [5])
    action = torch.rand(5, 2)
    after = [
        env.step(reset_at(env, given.clone()).set(keys.ACTION, action))["next"]
        for env in (one, many)
    ]
    for key in (keys.POSE, keys.VELOCITY, ("servo", "angle")):
        torch.testing.assert_close(after[0][key], after[1][key])
    check_env_specs(one, check_dtype=True)


def test_what_is_no_simulator_or_of_another_size_is_refused():
    with pytest.raises(ValueError, match=r"simulator x is a dict: .* EnvBase"):
        preflight_simulator.check_simulator(lambda cars: {}, "x")  # type: ignore[arg-type, return-value]
    with pytest.raises(ValueError, match=r"batch size \[1\] where \[5\] was asked"):
        preflight_simulator.check_simulator(lambda cars: make_engine("hold", 1), "x")
    with pytest.raises(ValueError, match=r"control period 0.02 s: must be 0.01 s"):
        preflight_simulator.check_simulator(lambda cars: make_engine("hold", cars, dt=0.02), "x")
    with pytest.raises(ValueError, match="cannot be built for 5 cars: ValueError: no engine"):
        preflight_simulator.check_simulator(lambda cars: make_engine("teleport", cars), "x")

    def blind(cars):
        return TransformedEnv(make_engine("kinematic", cars), ExcludeTransform(keys.POSE))

    with pytest.raises(ValueError, match=r"simulator x: .* gives no 'pose'; it must give"):
        preflight_simulator.check_simulator(blind, "x")


def test_an_error_in_a_step_names_the_simulator_and_any_other_passes():
    drive = toy_drive("lap", 400, 0)
    drive.data[keys.ACTION][200:, 0] = 1.0
    segments = cut_segments([drive], 1.0, 1.0)
    words = "simulator mine: step raised ZeroDivisionError"
    with pytest.raises(ValueError, match=words) as told, preflight_simulator.blaming("mine"):
        Simulation(Crashing).residuals(segments)
    assert isinstance(told.value.__cause__, ZeroDivisionError)
    with pytest.raises(KeyError, match="ours"), preflight_simulator.blaming("mine"):
        raise KeyError("ours")


def test_a_rollout_that_is_not_finite_is_reported_with_its_recording_and_time():
    drives = [toy_drive(name, 500, seed) for seed, name in enumerate("ab")]
    segments = cut_segments(drives, 1.0, 1.0)  # starts at 0, 1, 2, 3 s of each
    residual = torch.zeros(8, 10, 6)
    instants = Simulation(Crashing).instants(segments)
    assert check_residuals(residual, segments, instants, ["a", "b"], "x") == []
    residual[6, 4:, 2] = float(
        "nan"
    )  # drive b from 2 s, the reading 0.5 s after the start at 0.3 s
    notes = check_residuals(residual, segments, instants, ["a", "b"], "x")
    assert notes == [
        "simulator x returns NaN in 1 of 8 segments, first in drive b at 2.80 s; those count as "
        "very wrong"
    ]
    residual[:5, 9, 3] = 60.0
    with pytest.raises(ValueError, match=r"x runs away in 6 of 8 .* drive a at 1\.30 s; play"):
        check_residuals(residual, segments, instants, ["a", "b"], "x")


def test_good_drives_pass_without_a_note():
    drives = [toy_drive(name, 500, seed) for seed, name in enumerate("ab")]
    assert preflight.check_drives(drives, 1.0) == []
    assert check_blocks(blocks(cut_segments([toy_drive("a", 1400, 0)], 1.0, 1.0))) == []


def test_drives_that_show_nothing_are_refused():
    still = toy_drive("still", 300, 0)
    still.data[keys.POSE][:] = 0.001 * torch.rand(300, 3)
    broken = toy_drive("broken", 300, 0)
    broken.data[keys.VELOCITY][77, 1] = float("nan")
    fast = toy_drive("fast", 300, 0)
    fast.dt = 0.02
    for recordings, words in (
        ([], "no drive to compare with"),
        ([toy_drive("stub", 130, 0)], r"no drive covers 1.31 s without a gap \(stub has 1.30 s\)"),
        ([still], "the car does not move in still"),
        ([broken], "drive broken, row 77: velocity is no number"),
        ([fast], "drive fast has control period 0.02 s"),
    ):
        with pytest.raises(ValueError, match=words):
            preflight.check_drives(recordings, 1.0)


def test_what_drives_cannot_show_is_noted():
    lap, other = toy_drive("lap", 500, 0), toy_drive("other", 500, 1)
    [note] = preflight.check_drives([lap], 1.0)
    assert note.startswith("one drive only: blocks of 8 s of it are held out")
    [note] = preflight.check_drives([lap, other, toy_drive("stub", 100, 2)], 1.0)
    assert note == "drive stub is left out: its longest part is 1.00 s, not 1.31 s without a gap"
    for drive in (lap, other):
        drive.data[keys.ACTION][:, 1] = 0.25
    [note] = preflight.check_drives([lap, other], 1.0)
    assert note.startswith("steering is 0.25 all the time: nothing that depends on it")
    [note] = check_blocks(blocks(cut_segments([lap], 1.0, 1.0)))
    assert "nothing can be held out" in note


def test_dropped_frames_are_counted_with_what_is_left():
    # 500 rows less 100 to 119 and 300 to 379: a fifth is missing; of the runs of 100, 180 and 120
    # rows only the middle one is as long as a segment.
    drive = toy_drive("torn", 500, 0)
    kept = [*range(100), *range(120, 300), *range(380, 500)]
    drive.data = drive.data[torch.tensor(kept)]
    drive.data[keys.SEGMENT] = torch.tensor([0] * 100 + [1] * 180 + [2] * 120)
    [note] = preflight.check_drives([drive, toy_drive("whole", 500, 1)], 1.0)
    assert note == (
        "drive torn: 20% of the frames are missing, in 2 gaps; 1.8 of 5.0 s can be compared"
    )


def test_clocks_that_differ_by_more_than_a_sample_are_noted():
    assert check_clock(0.014) == check_clock(-0.014) == []
    assert check_clock(0.03)[0].startswith("commands act 30 ms later than they are stamped")
    assert check_clock(-0.02)[0].startswith("commands act 20 ms earlier")


def test_a_counting_drive_is_no_motion_of_a_car_but_moves():
    assert len(preflight.check_drives([counting_drive("a", 300)], 1.0)) == 1  # one drive only
