"""Cars drawn from a secret."""

from collections import Counter

from buggy_rl.proof.cases.sizes import CAMERA, NAMED_SINCE, SIZES, UNKNOWN_SIZES
from buggy_rl.proof.plants import abilities
from buggy_rl.proof.transfer.draw import CLASSES, drawn_cars

CLASS_OF = {effect: name for name, effects in CLASSES.items() for effect in effects}


def test_every_effect_that_a_car_can_have_is_in_one_class():
    listed = [effect for effects in CLASSES.values() for effect in effects]
    able = abilities("reference") & {*SIZES, *UNKNOWN_SIZES} - set(NAMED_SINCE)
    assert sorted(listed) == sorted(able)
    assert not set(listed) & set(CAMERA)


def test_every_tenth_car_has_nothing_wrong():
    cars = drawn_cars(20, "a secret")
    assert [name for name, case in cars.items() if not case.concealed] == ["10", "20"]


def test_classes_and_numbers_of_effects_are_balanced():
    cars = drawn_cars(40, "a secret")
    sizes = Counter(len(case.concealed) for case in cars.values())
    assert sizes == {0: 4, 1: 18, 2: 18}
    classes = Counter(CLASS_OF[effect] for case in cars.values() for effect in case.concealed)
    assert set(classes) == set(CLASSES)
    assert set(classes.values()) == {7, 8}  # 54 effects of seven classes


def test_two_effects_of_a_car_are_of_two_classes():
    for secret in map(str, range(20)):
        for case in drawn_cars(30, secret).values():
            assert len({CLASS_OF[effect] for effect in case.concealed}) == len(case.concealed)


def test_numbers_are_within_the_ranges_of_the_generator():
    for case in drawn_cars(60, "a secret").values():
        for effect, numbers in case.concealed.items():
            ranges = (SIZES | UNKNOWN_SIZES)[effect]
            assert set(numbers) == set(ranges)
            assert all(ranges[n].low <= abs(v) <= ranges[n].high for n, v in numbers.items())


def test_more_cars_leave_the_first_as_they_are_and_another_secret_does_not():
    few, many = drawn_cars(5, "a secret"), drawn_cars(9, "a secret")
    assert list(many.items())[:5] == list(few.items())
    other = drawn_cars(5, "another")
    assert all(other[name] != case for name, case in few.items())
    assert len({case.seed for case in many.values()}) == 9
