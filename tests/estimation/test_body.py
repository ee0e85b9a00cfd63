"""What a body can have bounds a fit, and what cars do not have is said."""

import pytest

from buggy_rl.core.car_file import load_car
from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.estimation.body import (
    body_of,
    bounded_by,
    implausible,
    most_yaw_inertia,
    top_speeds,
)
from buggy_rl.estimation.fit_result import Estimate
from buggy_rl.estimation.least_squares import FitConfig, _chosen, plausible
from buggy_rl.simulators import as_car, make_engine

# A plate of 2 kg, 0.3 m long and 0.2 m wide: m (l^2 + w^2) / 12 = 0.02167 kg m^2, times 1.3.
PLATE = VehicleDimensions(
    length=0.3, track_width=0.17, wheel_width=0.03, mass=2.0, wheelbase=0.2, cg_to_front_axle=0.1
)


def dart():
    made = as_car("single_track", "dart")
    return make_engine("single_track", 1, parameters=made["parameters"], **made["options"])


def test_the_most_yaw_inertia_is_that_of_a_plate_and_a_third():
    assert most_yaw_inertia(PLATE) == pytest.approx(1.3 * 2.0 * (0.09 + 0.04) / 12)


def test_a_fit_of_the_yaw_inertia_ends_at_what_the_cars_body_can_have():
    car = dart()
    most = most_yaw_inertia(body_of(car))
    assert 0.014 < most < 0.02  # 0.0221 was fitted where nothing bounded it; 0.0048 is published
    declared = car.declared["yaw_inertia"]
    assert declared.upper > most
    [p] = _chosen(car, FitConfig(parameters=["yaw_inertia"]))
    assert (p.lower, p.value, p.upper) == (declared.lower, declared.value, pytest.approx(most))
    [mass] = _chosen(car, FitConfig(parameters=["mass"]))
    assert mass == car.declared["mass"]
    assert bounded_by(None, declared) == declared


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"yaw_inertia": 0.02}, {}),  # k^2 = 0.01 = a b
        ({"yaw_inertia": 0.026}, {"yaw_inertia": "k^2/(ab) is 1.3"}),
        ({"yaw_inertia": 0.03}, {"yaw_inertia": "the most that a body"}),
        ({"front_grip": 0.9, "rear_grip": 1.5}, {"rear_grip": "tyres have 0.2 to 1.3"}),
        ({"steering_dead_time": 0.2, "steering_lag": 0.1}, {"steering_dead_time": "0.3 s late"}),
        ({"steering_dead_time": 0.05, "steering_lag": 0.05}, {}),
    ],
)
def test_values_that_cars_do_not_have_are_said(values, expected):
    found = implausible(values, PLATE)
    assert found.keys() == expected.keys()
    assert all(words in found[name] for name, words in expected.items())


def test_the_top_speed_is_where_motor_and_resistances_balance():
    own = {"drive_force": 7.0, "dry_friction": 1.0, "drive_force_loss": 0.5}
    # 7 - 1 = (0.5 + 0.5) v + 1 v^2 at 2 m/s.
    values = own | {"viscous_friction": 0.5, "quadratic_drag": 1.0}
    reached, known = top_speeds(dart(), values)
    assert reached == pytest.approx(2.0)
    assert known == pytest.approx(load_car("dart").top_speed)
    assert top_speeds(make_engine("single_track", 1), values) is None  # of no car's file
    assert top_speeds(dart(), {}) is None


def test_a_top_speed_far_from_the_cars_file_is_said():
    assert "drive_force" in implausible({}, None, (9.0, load_car("dart").top_speed))
    assert implausible({}, None, (5.2, 5.0)) == {}


def test_a_fitted_value_carries_the_warning():
    car = dart()
    most = most_yaw_inertia(body_of(car))
    odd = Estimate(car.declared["yaw_inertia"], most, 0.01, most, ("first",))
    fine = Estimate(car.declared["mass"], 1.58, 1.5, 1.6)
    [told, same] = plausible([odd, fine], car)
    assert told.warnings[0] == "first"
    assert "tyre relaxation" in told.warnings[1]
    assert same.warnings == ()
