import pytest

from buggy_rl.estimation.hypothesis import Library, bounded
from buggy_rl.parameters import Parameter
from tests.diagnosis.planted import fitter


def test_a_planted_effect_is_recovered_and_a_wrong_one_does_not_explain_it(late):
    fit, (right, wrong) = late
    assert right.values()["steering_dead_time"]["dead_time"] == pytest.approx(0.06, rel=0.05)
    assert abs(right.values()[""]["clock_offset"]) < 0.005
    assert float(right.square.mean()) / 60 == pytest.approx(1.0, abs=0.15)
    assert fit.value(wrong) > fit.value(right) + 100


def test_two_effects_in_one_explanation_are_told_apart(drives):
    fit = fitter(drives["two"])
    [both] = fit.fit([fit.start(["viscous_drag", "steering_gain"])])
    assert both.values()["steering_gain"]["gain"] == pytest.approx(0.8, rel=0.03)
    assert both.values()["viscous_drag"]["rate"] == pytest.approx(0.5, rel=0.1)


def test_a_parameter_of_the_simulators_own_is_recovered(drives):
    fit = fitter(drives["heavy"], parameters=["drive_force"])
    assert fit.player.make(1).declared["drive_force"].value > 5.0
    [found] = fit.fit([fit.start(["parameter:drive_force"])])
    assert found.values()["parameter:drive_force"]["drive_force"] == pytest.approx(4.0, rel=0.03)


def test_nothing_is_fitted_to_drives_of_the_same_simulator(drives):
    fit = fitter(drives["nothing"])
    [gain] = fit.fit([fit.start(["steering_gain"])])
    assert gain.values()["steering_gain"]["gain"] == pytest.approx(1.0, abs=0.02)


def test_values_stay_within_their_bounds_and_a_start_out_of_them_is_brought_in(late):
    fit, _ = late
    outside = fit.start(["steering_dead_time"], [-3.0, 0.0])
    [found] = fit.fit([outside], 1)
    assert found.values()["steering_dead_time"]["dead_time"] >= 0.0
    assert found.slopes is not None
    assert found.slopes.shape == (len(fit.cut), 60, 2)


def test_a_number_at_the_end_of_its_range_is_told(late):
    fit, (right, _) = late
    assert right.at_bound("steering_dead_time") == ()
    slippery = fit.start(["grip_patch"], [0.0, 0.0, 0.0, -99.0, 0.0])
    slippery.place = bounded(slippery.unknowns, slippery.place)
    assert slippery.at_bound("grip_patch") == ("grip",)


def test_of_a_patch_its_grip_says_how_much_of_it_there_is():
    library = Library(parameters={"mass": Parameter("mass", 1.0, 0.5, 2.0, "kg", "of the car")})
    assert library.deciding("grip_patch") == {"grip"}
    assert library.deciding("floor_slope") == {"along_x", "along_y"}
    assert library.deciding("parameter:mass") == {"mass"}
