"""The central test: a car with an effect of the library, driven by the edited log, moves as logged.

The car P is the single track with its sensor at the centre of gravity. P driven by u gave y. Every
named edit makes (u', y') of that; P with the library's effect, driven by u', must show y'.
"""

import random
from functools import cache

import numpy as np
import pytest
import torch

from buggy_rl.core import keys
from buggy_rl.effects import STACK, effect_class, in_order
from buggy_rl.proof.real.edits import EDITS, NAMED, UNKNOWN, applicable, edited
from buggy_rl.proof.real.edits.base import log_rows
from buggy_rl.recordings import load_recording
from tests.proof.real.plant import RESTING, SPEED, commands, driven, neutral, recording

VALUES = {
    "battery_sag": {"loss_per_minute": 0.2},
    "throttle_gain": {"gain": 0.8},
    "throttle_deadband": {"width": 0.1, "restored": 1.0},
    "throttle_dead_time": {"dead_time": 0.12},
    "steering_offset": {"offset": -0.13},
    "steering_gain": {"gain": 1.2},
    "steering_asymmetry": {"left_to_right": 1.3},
    "steering_backlash": {"width": 0.1},
    "steering_dead_time": {"dead_time": 0.07},
    "sensor_latency": {"dead_time": 0.04},
    "sensor_lever_arm": {"x": 0.04, "y": -0.03},
    "sensor_yaw": {"angle": 0.08},
    "speed_scale": {"ratio": 0.9},
    "gyro_bias": {"bias": -0.1},
}
SMALLER = {"steering_backlash": {"width": 0.08}, "steering_offset": {"offset": 0.08}}  # in range
PAIRS = [
    ("throttle_gain", "throttle_dead_time"),
    ("steering_offset", "steering_dead_time"),
    ("steering_backlash", "steering_dead_time"),
    ("throttle_deadband", "steering_asymmetry"),
    ("sensor_latency", "sensor_lever_arm"),
    ("sensor_lever_arm", "sensor_yaw"),
    ("battery_sag", "gyro_bias"),
]
EXACT = 2e-5  # [m, rad, m/s, rad/s] single precision over 2.5 s


@cache
def untouched(**told):
    """The drive that is edited."""
    return recording(commands(**told), **told)


def deviation(concealed, effects=None, drive=None) -> float:
    """Greatest difference between what the edited recording shows and the car with the effect."""
    drive = drive or untouched()
    changed = edited(drive, concealed)
    assert changed is not None
    first = round(float(changed.data[keys.TIME][0, 0]) / changed.dt)
    given = torch.cat([drive.data[keys.ACTION][:first], changed.data[keys.ACTION]])
    shown = driven(given, concealed if effects is None else effects, drive.command)
    return max(
        float((shown[key][first:] - changed.data[key]).abs().max())
        for key in (keys.POSE, keys.VELOCITY)
    )


def off(concealed):
    """The same effects with a tenth less of what each changes."""
    rest = {name: neutral(effect_class(name).declared) for name in concealed}
    return {
        name: {p: n + 0.9 * (values[p] - n) for p, n in rest[name].items()}
        for name, values in concealed.items()
    }


def test_every_named_edit_has_its_values_here():
    assert set(VALUES) == set(NAMED)


@pytest.mark.parametrize("name", NAMED)
def test_the_car_with_the_effect_moves_as_the_edited_recording_shows(name):
    assert deviation({name: VALUES[name]}) < EXACT


@pytest.mark.parametrize("name", NAMED)
def test_another_size_of_the_effect_is_seen(name):
    assert deviation({name: VALUES[name]}, off({name: VALUES[name]})) > 20 * EXACT


@pytest.mark.parametrize("names", PAIRS, ids="+".join)
def test_two_edits_are_the_car_with_both_effects(names):
    concealed = {name: VALUES[name] for name in names}
    assert deviation(concealed) < EXACT
    assert deviation(concealed, {names[0]: VALUES[names[0]]}) > 20 * EXACT


@pytest.mark.parametrize("name", [n for n in NAMED if EDITS[n].speed_too])
def test_edits_of_a_speed_command_are_as_exact(name):
    assert deviation({name: VALUES[name]}, drive=untouched(command=SPEED)) < EXACT


def test_a_deadband_of_which_nothing_is_restored_is_exact_too():
    concealed = {"throttle_deadband": {"width": 0.1, "restored": 0.0}}
    assert deviation(concealed) < EXACT


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMED)
def test_logs_of_the_real_car_are_edited_as_exactly(name, dart_folder, repository):
    [file] = dart_folder.rglob("*09_04_2024_12_34_30.csv")  # neither lock is reached
    drive = load_recording(file, repository / "configs" / "columns" / "dart.yaml", car="dart")
    log = drive.data[keys.ACTION][800:1200]
    assert float(log[:, 1].std()) > 0.3
    resting = recording(torch.cat([commands()[:RESTING], log]))  # the car rests, then gets it
    assert deviation({name: VALUES[name] | SMALLER.get(name, {})}, drive=resting) < EXACT


def test_edits_stand_in_the_order_of_the_effects():
    assert [*NAMED] == in_order(NAMED)
    assert set(NAMED) <= set(STACK)
    assert not set(UNKNOWN) & set(STACK)


@pytest.mark.parametrize("name", EDITS)
def test_a_size_is_drawn_from_the_seed_and_within_what_the_effect_takes(name):
    edit = EDITS[name]
    drawn = [edit.drawn(random.Random(seed)) for seed in range(200)]
    assert drawn[0] == edit.drawn(random.Random(0)) != drawn[1]
    if not edit.known:
        return
    bounds = {p.name: p for p in effect_class(name).declared}
    for values in drawn:
        assert set(values) == set(bounds)
        assert all(bounds[n].lower <= v <= bounds[n].upper for n, v in values.items())


@pytest.mark.parametrize(("name", "values"), [
    ("steering_gain", {"gain": 0.5}),
    ("steering_offset", {"offset": 0.6}),
    ("throttle_gain", {"gain": 0.3}),
    ("cross_talk", {"share": 4.0}),
])  # fmt: skip
def test_a_command_that_would_have_to_be_out_of_range_is_no_edit(name, values):
    assert edited(untouched(), {name: values}) is None


def test_a_steering_edit_needs_steering_that_varies():
    log = commands()
    log[:, 1] = 0.3
    straight = recording(log)
    assert not applicable(straight, ["steering_gain"])
    assert not applicable(straight, ["sensor_yaw", "steering_dead_time"])
    assert applicable(straight, ["throttle_gain", "sensor_yaw"])
    assert applicable(untouched(), ["steering_gain"])


def test_a_speed_command_has_no_battery():
    drive = recording(commands(command=SPEED), command=SPEED)
    assert not applicable(drive, ["battery_sag"])
    assert applicable(drive, ["throttle_gain", "steering_dead_time"])


def test_no_edit_leaves_every_number_as_it_is():
    drive = untouched()
    same = edited(drive, {})
    assert same is not None
    for key in (keys.TIME, keys.POSE, keys.VELOCITY, keys.ACTION, keys.SEGMENT):
        assert torch.equal(same.data[key], drive.data[key])


def test_an_edit_reaches_across_no_gap():
    drive = recording(commands(400))
    drive.data[keys.SEGMENT][200:] = 1
    changed = edited(drive, {"steering_dead_time": {"dead_time": 0.05}})
    assert changed is not None
    sizes = changed.data[keys.SEGMENT].bincount().tolist()
    assert sizes == [195, 195]
    first = [rows.steering[:195] for rows in log_rows(changed)]
    assert np.allclose(first[0], drive.data[keys.ACTION][5:200, 1])
    assert np.allclose(first[1], drive.data[keys.ACTION][205:400, 1])


@pytest.mark.parametrize(("name", "values", "throttle", "steering"), [
    # drive 0.25 = 0.5^2; steering -0.64 = -(0.8^2)
    ("throttle_exponent", {"exponent": 2.0}, [0.0, 0.0], [0.5, -0.64]),
    ("steering_exponent", {"exponent": 2.0}, [-0.5, -0.5], [0.5**0.5, -0.8]),
    ("cross_talk", {"share": 0.4}, [-0.5, -0.5], [0.4, -0.74]),
    ("quantised_log", {"step": 0.3}, [-0.6, -0.6], [0.6, -0.6]),
])  # fmt: skip
def test_unknown_edits_by_hand(name, values, throttle, steering):
    log = torch.tensor([[-0.5, 0.5], [-0.5, -0.64]]).repeat_interleave(40, 0)
    changed = edited(recording(log), {name: values})
    assert changed is not None
    assert changed.data[keys.ACTION][[0, 79], 0].tolist() == pytest.approx(throttle, abs=1e-6)
    assert changed.data[keys.ACTION][[0, 79], 1].tolist() == pytest.approx(steering, abs=1e-6)


def test_a_log_that_is_held_has_a_new_command_every_fifth_of_a_second():
    log = torch.stack([torch.full((100,), -1.0), torch.linspace(-0.9, 0.9, 100)], -1)
    changed = edited(recording(log), {"held_log": {"phase": 0.05}})
    assert changed is not None
    new = changed.data[keys.ACTION][:, 1].diff().nonzero().squeeze(-1) + 1
    assert new.tolist() == [15, 35, 55, 75, 95]
    assert torch.equal(changed.data[keys.ACTION][15], log[15])


def test_a_periodic_dead_time_comes_and_goes():
    log = torch.stack([torch.full((300,), -1.0), torch.arange(300) / 300], -1)
    changed = edited(recording(log), {"periodic_dead_time": {"longest": 0.1, "period": 2.0}})
    assert changed is not None
    early = (300 * changed.data[keys.ACTION][:, 1]).round().long() - torch.arange(290)
    assert early[[0, 50, 100, 150, 200]].tolist() == [0, 5, 10, 5, 0]
