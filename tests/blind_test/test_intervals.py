"""Form errors are found where numbers are off by more than chance, and intervals cover."""

import math

import numpy as np
import pytest

from buggy_rl.blind_test.intervals import Number, covered, form_error, left_out, numbers
from buggy_rl.diagnosis.form_error import FormError
from tests.blind_test.test_calibration import entry
from tests.diagnosis.observations import hypothesis


def drawn(form, count=400, seed=0):
    """Numbers that are off by chance and by a form error."""
    chance = np.random.default_rng(seed)
    found = []
    for index in range(count):
        z, share = chance.uniform(0.5, 3.0), chance.uniform(0.0, 1.0)
        true = z + chance.normal() * form.sd(z, 0.05, share)
        found.append(Number(z, true, 0.05, share, str(index % 10)))
    return found


def test_the_form_error_that_numbers_were_drawn_with_is_found():
    found = form_error(drawn(FormError(0.05, 0.4)))
    assert found.always == pytest.approx(0.05, abs=0.03)
    assert found.remains == pytest.approx(0.4, abs=0.1)
    # Where numbers are off by chance alone, there is none.
    assert form_error(drawn(FormError(0.0, 0.0))) == FormError(0.0, 0.0)


def test_numbers_that_were_left_out_are_covered_as_often_as_intervals_say():
    inside, width = covered(left_out(drawn(FormError(0.05, 0.4))))
    assert inside.value == pytest.approx(0.95, abs=0.03)
    narrow, less = covered([(n, FormError(0.0, 0.0)) for n in drawn(FormError(0.05, 0.4))])
    assert narrow.value < 0.5
    assert less < width


def test_a_deviation_is_of_chance_and_both_forms():
    # 0.3, 0.1 2 and 0.5 0.4 2.
    assert FormError(0.1, 0.5).sd(2.0, 0.3, 0.4) == pytest.approx(math.hypot(0.3, 0.2, 0.4))


def test_the_numbers_of_a_case_are_those_of_the_true_set_beside_the_truth():
    values = {"steering_gain": {"gain": 0.8}, "": {"clock_offset": 0.0}}
    own = hypothesis(
        ("steering_gain",), [5.0, 5.0], 0.1, values=values, z=[-1.0, 0.0], sd=[0.1, 0.2]
    )
    other = hypothesis(("wind",), [9.0, 9.0], 0.6)
    told = entry(0, ["steering_gain"], [hypothesis((), [10.0, 10.0], 0.5), own, other])
    told["case"]["concealed"] = {"steering_gain": {"gain": 0.75}}
    [number] = numbers([told])
    assert (number.z, number.chance) == (-1.0, 0.1)
    assert number.true < 0  # it turns less than neutral
    assert number.share == pytest.approx(0.1 / 0.4)  # left, over what is closed
    assert numbers([entry(1, ["payload"], [own, other])]) == []  # the truth was not fitted
