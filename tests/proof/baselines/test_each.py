"""Each effect fitted alone: what the criteria choose, and that they choose nothing."""

import math

import pytest
import torch

from buggy_rl.estimation.noise_model import NoiseModel
from buggy_rl.proof.baselines.asked import open_question
from buggy_rl.proof.baselines.each import (
    by_bic,
    by_held_out_density,
    choices,
    least_loss,
    single_fits,
)
from buggy_rl.proof.baselines.greedy import greedy
from tests.proof.baselines.folder import shown

FEW = ["steering_dead_time", "steering_gain", "viscous_drag", "throttle_lag", "gyro_bias"]
METHODS = [by_bic, by_held_out_density, greedy]


@pytest.fixture(scope="module")
def cases(drives, tmp_path_factory):
    """Folder of what may be seen of each case; simulators are black boxes."""

    def folder(name):
        made = shown(tmp_path_factory.mktemp(name), drives[name], effects=FEW)
        with open(made / "question.yaml", "a") as question:
            question.write("parameters: false\nworkers: 1\n")
        return made

    return {name: folder(name) for name in ("nothing", "draggy", "late", "two")}


@pytest.mark.parametrize("method", METHODS)
def test_nothing_is_named_of_a_car_as_it_is(cases, method):
    said = method(cases["nothing"])
    assert (said["verdict"], said["effects"]) == ("no_mismatch", [])


@pytest.mark.parametrize("method", METHODS)
def test_drag_is_named_with_its_size(cases, method):
    said = method(cases["draggy"])
    [effect] = said["effects"]
    assert (said["verdict"], effect["name"]) == ("missing_physics", "viscous_drag")
    rate = effect["parameters"]["rate"]
    assert rate["value"] == pytest.approx(0.8, rel=0.1)
    assert rate["low"] < rate["value"] < rate["high"]
    assert effect["confidence"] > 0.9


@pytest.mark.parametrize("method", METHODS)
def test_a_dead_time_is_named_with_its_size(cases, method):
    [effect] = method(cases["late"])["effects"]
    assert effect["name"] == "steering_dead_time"
    assert effect["parameters"]["dead_time"]["value"] == pytest.approx(0.11, abs=0.01)


def test_of_two_effects_greedy_selection_names_both_and_the_others_one(cases):
    both = greedy(cases["two"])["effects"]
    assert {effect["name"] for effect in both} == {"viscous_drag", "steering_gain"}
    numbers = {e["name"]: [p["value"] for p in e["parameters"].values()] for e in both}
    assert numbers["viscous_drag"] == pytest.approx([0.8], rel=0.1)
    assert numbers["steering_gain"] == pytest.approx([0.8], rel=0.05)
    [one] = by_bic(cases["two"])["effects"]
    assert one["name"] in {"viscous_drag", "steering_gain"}


def test_the_fits_are_shared_by_all_methods(cases):
    asked = open_question(cases["draggy"])
    assert single_fits(asked) is single_fits(asked)
    names = [fit.effects for fit in single_fits(asked).fits]  # all five are among the best eight
    assert names[0] == ()
    assert {*names[1:]} == {(name,) for name in FEW}


def test_segments_are_those_of_the_diagnosis(cases):
    asked = open_question(cases["draggy"])
    assert single_fits(asked).problem.segments is asked.ready.problem.segments
    assert single_fits(asked).problem.simulation is asked.corrected


def test_a_loss_is_taken_at_its_best_dispersion():
    noise = NoiseModel(torch.eye(10, dtype=torch.float64).expand(1, 10, 10), torch.ones(6))
    # Residuals of four times the variance, 20 segments of 10 numbers: with h = 40 the density has
    # its maximum at phi = 4, sum 50/2 ln(1 + 10 / 40) + 100 ln 4; the nearest tried is 3.98.
    square = torch.full((20,), 40.0, dtype=torch.float64)
    at_four = 20 * 25 * math.log(1.25) + 100 * math.log(4.0)
    assert at_four <= least_loss(noise, square) < at_four + 0.01
    assert least_loss(noise, 0 * square) == 0.0


def test_one_of_fifty_is_chosen_in_fifty_ways():
    assert choices(50, 0) == 0.0
    assert choices(50, 1) == pytest.approx(math.log(50))
    assert choices(50, 2) == pytest.approx(math.log(1225))
