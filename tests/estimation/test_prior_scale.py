"""Prior scales of effects follow the car; those of the buggy stay."""

import pytest

from buggy_rl.core.vehicle import Similarity
from buggy_rl.effects import STACK, effect_class
from buggy_rl.estimation.hypothesis import Library, scaled_prior

LARGE = Similarity(mass=1000.0, length=10.0, speed=10.0**0.5)


@pytest.mark.parametrize("name", STACK)
def test_those_of_the_buggy_are_the_declared_ones(name):
    own = Library([name]).numbers(name)
    kind = effect_class(name)
    assert own == tuple(p for p in kind.declared if p.name not in kind.alternatives)


@pytest.mark.parametrize(
    ("effect", "number", "factor"),
    [
        ("yaw_damping", "rate", 1 / 10**0.5),
        ("one_sided_drag", "yaw_acceleration", 1 / 10),
        ("aerodynamic_drag", "coefficient", 1 / 10),
        ("motor_power_limit", "power_per_mass", 10**0.5),
        ("sensor_lever_arm", "x", 10.0),
        ("grip_patch", "radius", 10.0),
        ("steering_dead_time", "dead_time", 1.0),
        ("floor_slope", "along_x", 1.0),
    ],
)
def test_those_of_a_full_size_car_are_similar(effect, number, factor):
    (declared,) = (p for p in effect_class(effect).declared if p.name == number)
    of_car = scaled_prior(declared, LARGE)
    assert of_car.size == pytest.approx(factor * declared.size)
    assert of_car.value == declared.value  # neutral is neutral
    assert of_car.lower <= declared.lower < declared.upper <= of_car.upper


def test_a_limit_keeps_its_neutral_end():
    (declared,) = effect_class("motor_power_limit").declared
    of_car = scaled_prior(declared, LARGE)
    assert of_car.value == of_car.upper == declared.upper
