"""Effects that a simulator realises by parameters: one name, the effect's number, its bounds."""

import pytest
import torch

from buggy_rl.core.parameters import Added, Parameter, Scaled
from buggy_rl.estimation.hypothesis import Library

DECLARED = {
    p.name: p
    for p in (
        Parameter("front", 0.8, 0.4, 1.6, "-", "Grip of the front axle."),
        Parameter("rear", 1.0, 0.4, 1.6, "-", "Grip of the rear axle."),
        Parameter("delay", 0.04, 0.0, 0.2, "s", "Of the servo."),
        Parameter("mass", 1.6, 1.2, 2.4, "kg", "Whole car."),
        Parameter("loss", 0.0, 0.0, 4.0, "N s/m", "Back-EMF."),
    )
}
REALISES = {
    "tire_grip": [Scaled("front", "grip"), Scaled("rear", "grip")],
    "grip_balance": [
        Scaled("front", "front_to_rear", 0.5),
        Scaled("rear", "front_to_rear", -0.5),
    ],
    "steering_dead_time": [Added("delay", "dead_time")],
    "top_speed": [Scaled("loss", "speed_ratio", -1.0)],
}
EFFECTS = [*REALISES, "gyro_bias"]


@pytest.fixture
def library():
    return Library(EFFECTS, DECLARED, True, REALISES)


def settings(library, **numbers):
    own = library.hypothesis(list(numbers))
    vector = [c.parameter.coordinate(numbers[c.effect]) for c in own.coordinates[:-1]]
    own = library.hypothesis(list(numbers), [*vector, 0.0])
    return library.settings([(library.hypothesis(()), torch.zeros(1)), (own, own.vector)])


def test_a_parameter_that_is_an_effect_has_no_second_name(library):
    # The front grip alone may be wrong, which no single effect is; the loss is 0 and stays so.
    own = ["parameter:front", "parameter:rear", "parameter:mass", "parameter:loss"]
    assert library.names == [*EFFECTS, *own]
    assert "tire_grip" in library.inside
    assert "top_speed" not in library.inside
    assert library.inside.parameters_of("tire_grip") == ("front", "rear")
    assert library.inside.parameters_of("gyro_bias") == ()


def test_their_numbers_act_on_the_parameters_and_on_nothing_else(library):
    rolled = settings(library, tire_grip=0.75, steering_dead_time=0.05, gyro_bias=0.1)
    assert set(rolled.effects) == {"gyro_bias"}
    assert rolled.parameters["front"].tolist() == pytest.approx([0.8, 0.6])
    assert rolled.parameters["rear"].tolist() == pytest.approx([1.0, 0.75])
    assert rolled.parameters["delay"].tolist() == pytest.approx([0.04, 0.09])


def test_the_simulator_as_given_is_not_changed_by_a_bit(library):
    rolled = settings(library, tire_grip=0.75)
    assert rolled.parameters["front"][0] == torch.tensor(0.8)


def test_several_of_one_parameter_act_together(library):
    rolled = settings(library, tire_grip=0.75, grip_balance=1.21)
    assert rolled.parameters["front"].tolist() == pytest.approx([0.8, 0.8 * 0.75 * 1.1])
    assert rolled.parameters["rear"].tolist() == pytest.approx([1.0, 0.75 / 1.1])
    beside = {"tire_grip": {"grip": 0.75}}
    assert library.inside.values(beside, {"front": 1.0, "mass": 2.0}) == pytest.approx(
        {"front": 0.75, "rear": 0.75, "mass": 2.0}
    )


def test_a_number_keeps_scale_and_unit_and_is_bounded_by_the_declared_ranges(library):
    [grip], [wrapped] = library.numbers("tire_grip"), Library(EFFECTS).numbers("tire_grip")
    assert (grip.size, grip.unit, grip.value) == (wrapped.size, wrapped.unit, wrapped.value)
    # front 0.4..1.6 of 0.8 is 0.5..2, rear 0.4..1.6 of 1 is 0.4..1.6
    assert (grip.lower, grip.upper) == pytest.approx((0.5, 1.6))


def test_a_simulated_dead_time_may_be_too_long_as_well(library):
    [late] = library.numbers("steering_dead_time")
    assert (late.lower, late.upper) == pytest.approx((-0.04, 0.16))
    assert Library(EFFECTS).numbers("steering_dead_time")[0].lower == 0.0
    assert settings(library, steering_dead_time=-0.04).parameters["delay"][1] == pytest.approx(0.0)


def test_parameters_stay_within_their_ranges(library):
    rolled = settings(library, tire_grip=1.5, grip_balance=5.0)
    assert rolled.parameters["front"].tolist() == pytest.approx([0.8, 1.6])


def test_without_a_mapping_nothing_is_realised():
    plain = Library(EFFECTS, DECLARED)
    assert plain.names == [*EFFECTS, *(f"parameter:{name}" for name in DECLARED)]
    assert set(settings(plain, tire_grip=0.75).effects) == {"tire_grip"}


@pytest.mark.parametrize(
    ("realises", "words"),
    [
        ({"tire_grip": [Scaled("friction", "grip")]}, "friction.*does not declare; declared: del"),
        ({"tire_grip": [Scaled("front", "ratio")]}, "is of ratio: expected changes by each of gri"),
        ({"throttle_deadband": [Added("loss", "width")]}, "each of restored, width"),
        ({"no_such": [Added("loss", "width")]}, "no effect 'no_such'"),
    ],
)
def test_a_wrong_mapping_is_refused_in_a_line(realises, words):
    with pytest.raises(ValueError, match=words):
        Library(EFFECTS, DECLARED, True, realises)
