"""What steps lack, and what effects make of it."""

import pytest
import torch

from buggy_rl.effects import EFFECTS, effect_class
from buggy_rl.estimation.hypothesis import Library
from buggy_rl.estimation.noise_model import sensor_noise
from buggy_rl.estimation.segments import cut_segments
from buggy_rl.proof.baselines.asked import open_question
from buggy_rl.proof.baselines.columns import SPAN, effect_columns, residual_columns
from tests.proof.baselines.folder import shown

CHANNELS = ("x", "y", "yaw", "vx", "vy", "yaw_rate")


def prior_scale(effect):
    return effect_class(effect).declared[0].size


def found(drives, folder, *effects, engine="single_track"):
    return residual_columns(open_question(shown(folder, drives, engine, effects=effects)))


def test_a_right_simulator_lacks_no_more_than_noise(drives, tmp_path):
    lacking = found(drives["nothing"], tmp_path, "gyro_bias").lacking
    assert lacking.shape[1:] == (10, 6)
    # A parabola over 15 rows keeps 15 % of the variance; the ends of ten rows are two of it:
    # sqrt(2 * 0.15) = 0.55 of a row's noise, and what a parabola cuts off a step of the command.
    assert 0.2 < float(lacking.abs().median()) < 1.0


def test_an_effect_explains_what_a_car_with_it_lacks(drives, tmp_path):
    made = found(drives["draggy"], tmp_path, "viscous_drag", "steering_gain")
    assert [feature.effect for feature in made.features] == ["viscous_drag", "steering_gain"]
    left = made.lacking - 0.8 / prior_scale("viscous_drag") * made.explained[0]  # of 0.8 1/s
    assert float(left[..., 3].norm()) < 0.4 * float(made.lacking[..., 3].norm())
    assert float(made.explained[0, ..., 4].abs().max()) < float(made.explained[1, ..., 4].std())


def test_an_effect_on_the_sensing_changes_what_was_measured(drives, tmp_path):
    made = found(drives["nothing"], tmp_path, "gyro_bias", engine="hold")
    noise = sensor_noise(cut_segments(drives["nothing"], 1.3, 1.0))
    # `hold` turns on with the yaw rate it is given; of a bias less, that much is left over in the
    # heading: the bias over ten rows in units of its noise, and nothing in any other rate.
    expected = -prior_scale("gyro_bias") * SPAN * 0.01 / float(noise[2])
    yaw = made.explained[0, ..., CHANNELS.index("yaw")]
    torch.testing.assert_close(yaw, torch.full_like(yaw, expected), rtol=0.02, atol=0.0)
    rest = made.explained[0, ..., [0, 1, 3, 4, 5]].abs().max()
    assert float(rest) < 0.05 * abs(expected)


@pytest.mark.parametrize(
    ("effect", "count", "both_ways"),
    [
        ("steering_gain", 1, True),
        ("steering_lag", 1, False),
        ("floor_slope", 2, True),
        ("sensor_lever_arm", 2, True),
        ("grip_patch", 16, True),
        ("steering_dead_time", 5, False),
        ("sensor_latency", 5, False),
    ],
)
def test_a_vector_has_a_column_for_each_part_a_patch_and_a_delay_for_each_place(
    drives, effect, count, both_ways
):
    made = effect_columns(Library(), effect, cut_segments(drives["nothing"], 1.3, 1.0))
    assert [feature.both_ways for feature in made] == [both_ways] * count


def test_every_effect_of_the_library_has_a_column_with_numbers_within_bounds(drives):
    segments, library = cut_segments(drives["nothing"], 1.3, 1.0), Library()
    for effect in EFFECTS:
        for feature in effect_columns(library, effect, segments):
            numbers = feature.numbers(50.0, 1.0)
            assert numbers, effect
            for coordinate in feature.coordinates:
                p = coordinate.parameter
                if p.name in numbers:
                    said = numbers[p.name]
                    assert said["low"] <= said["value"] <= said["high"]
                    assert said["low"] >= p.lower - 1e-6
                    assert said["high"] <= p.upper * (1 + 1e-6)


def test_a_coefficient_scales_the_grip_of_a_patch_and_leaves_its_position(drives):
    segments = cut_segments(drives["nothing"], 1.3, 1.0)
    feature = effect_columns(Library(), "grip_patch", segments)[0]
    whole, half = feature.numbers(1.0, 0.0), feature.numbers(0.5, 0.0)
    assert whole["x"] == half["x"]
    # The trial is half the grip; a coefficient of a half takes half of that away.
    assert whole["grip"]["value"] == pytest.approx(0.5)
    assert half["grip"]["value"] == pytest.approx(0.75)
