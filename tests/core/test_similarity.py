"""Froude similarity: what scales, and that the buggy itself does not."""

import math
from dataclasses import asdict

import pytest

from buggy_rl.core.parameters import Parameter
from buggy_rl.core.vehicle import GRAVITY, Similarity, VehicleDimensions, similar_dimensions
from buggy_rl.simulators import make_engine


def test_the_buggy_is_similar_to_itself_to_the_last_bit():
    scale = Similarity.between(VehicleDimensions())
    assert (scale.mass, scale.length, scale.speed) == (1.0, 1.0, 1.0)
    assert similar_dimensions({}) == VehicleDimensions()
    parameter = Parameter("drag", 0.1, 0.05, 0.3, "N s^2/m^2", "")
    assert scale.scaled(parameter) == parameter


@pytest.mark.parametrize(
    ("unit", "factor"),
    [
        ("N", 8.0),  # forces go with m g
        ("m", 4.0),
        ("m/s", 2.0),  # sqrt(L g)
        ("kg m^2", 8 * 16.0),  # m L^2
        ("N s/m", 8 / 2.0),  # force over speed
        ("N s^2/m^2", 8 / 4.0),
        ("rad/s", 2 / 4.0),
        ("s", 1.0),  # electronics
        ("ohm", 1.0),
        ("V", 4.0),  # voltage and current share the power m g v
        ("A", 4.0),
        ("rad/s^2", 1 / 4.0),
        ("1/rad", 1.0),
    ],
)
def test_a_car_of_four_times_the_length_and_eight_times_the_mass(unit, factor):
    buggy = VehicleDimensions()
    car = similar_dimensions({"wheelbase": 4 * buggy.wheelbase, "mass": 8 * buggy.mass})
    assert Similarity.between(car).of(unit) == pytest.approx(factor)


def test_a_known_top_speed_takes_the_place_of_the_law():
    scale = Similarity.between(similar_dimensions({"wheelbase": 0.348}), speed=3.0)
    assert scale.of("m/s") == 3.0
    assert scale.of("s/m") == pytest.approx(1 / 3)


def test_what_is_known_of_a_car_stays_and_the_rest_scales():
    car = similar_dimensions({"wheelbase": 0.348, "mass": 3.25, "cg_height": 0.05})
    buggy = VehicleDimensions()
    assert (car.wheelbase, car.mass, car.cg_height) == (0.348, 3.25, 0.05)
    assert car.track_width == pytest.approx(2 * buggy.track_width)
    assert car.yaw_inertia == pytest.approx(8 * buggy.yaw_inertia)  # 2 x 2^2


@pytest.mark.parametrize(
    ("known", "words"),
    [({"weight": 3.0}, "no dimension weight; available: length"), ({"mass": -1.0}, "above 0")],
)
def test_dimensions_that_cannot_be_are_refused(known, words):
    with pytest.raises(ValueError, match=words):
        similar_dimensions(known)


def test_a_unit_without_a_law_is_refused_with_those_that_have_one():
    with pytest.raises(KeyError, match=r"unit 'W'; available: .*N s/m"):
        Similarity().of("W")


@pytest.mark.parametrize("engine", ["single_track", "kinematic", "mujoco"])
def test_every_parameter_of_our_engines_has_a_law(engine):
    for parameter in make_engine(engine).declared.values():
        assert Similarity(2.0, 3.0, 4.0).of(parameter.unit) > 0


@pytest.mark.parametrize("engine", ["single_track", "kinematic", "mujoco"])
def test_naming_the_buggys_own_dimensions_changes_no_parameter(engine):
    plain, named = make_engine(engine), make_engine(engine, dimensions=asdict(VehicleDimensions()))
    assert named.declared == plain.declared
    assert named.vehicle() == plain.vehicle()


def test_similar_cars_drive_similar_paths():
    """At ten times the length and the same command, lengths are 10 and times sqrt(10) times."""
    import torch

    length = 10.0
    car = {"wheelbase": 0.174 * length, "mass": 1.625 * length**3}
    still = {"throttle_lag": 0.0, "throttle_dead_time": 0.0}
    still |= {"steering_lag": 0.0, "steering_dead_time": 0.0}
    ends = []
    for options, dt in (({}, 0.002), ({"dimensions": car}, 0.002 * math.sqrt(length))):
        engine = make_engine("single_track", (), parameters=still, dt=dt, **options)
        state = engine.reset()
        for _ in range(500):  # 1 s of the buggy
            state["action"] = torch.tensor([0.0, 0.5])
            state = engine.step(state)["next"].exclude("reward")
        ends.append((state["pose"], state["velocity"]))
    (pose, velocity), (far, fast) = ends
    assert torch.allclose(far[:2] / length, pose[:2], rtol=0.02, atol=1e-3)
    assert far[2].item() == pytest.approx(pose[2].item(), rel=0.02)
    assert torch.allclose(fast[:2] / math.sqrt(length), velocity[:2], rtol=0.02, atol=1e-3)
    assert math.hypot(*pose[:2].tolist()) > 0.5  # [m]
    assert velocity[0] < 0.5 * GRAVITY
