"""Form errors are found where numbers are off by more than chance, and intervals cover."""

import math

import numpy as np
import pytest

from buggy_rl.diagnosis.search.posterior import FormError
from buggy_rl.proof.calibrate.intervals import Number, covered, form_error, left_out, scored_numbers
from tests.diagnosis.observations import hypothesis
from tests.proof.test_calibration import entry


def drawn(form, count=2000, seed=0):
    """Numbers that are off by chance and by a form error."""
    chance = np.random.default_rng(seed)
    found = []
    for index in range(count):
        z, share = chance.uniform(0.5, 3.0), chance.uniform(0.0, 1.0)
        by_blocks = 10 ** chance.uniform(-3.0, -1.0)
        true = z + chance.normal() * form.sd(z, by_blocks, share)
        found.append(Number(z, true, z, by_blocks, str(index % 10), share))
    return found


@pytest.mark.parametrize(
    "form", [FormError(1.0, 0.0, 0.0), FormError(4.0, 0.05, 0.0), FormError(1.0, 0.05, 0.4)]
)
def test_intervals_cover_others_as_often_as_they_say_and_are_hardly_wider(form):
    found, others = form_error(drawn(form)), drawn(form, seed=1)
    inside, width = covered([(n, found) for n in others])
    assert inside.value == pytest.approx(0.95, abs=0.02)
    _, least = covered([(n, form) for n in others])
    assert width < 1.15 * least


def test_numbers_that_were_left_out_are_covered_as_often_as_intervals_say():
    of = drawn(FormError(1.0, 0.05, 0.4))
    inside, width = covered(left_out(of))
    assert inside.value == pytest.approx(0.95, abs=0.02)
    narrow, less = covered([(n, FormError(1.0, 0.0, 0.0)) for n in of])
    assert narrow.value < 0.5
    assert less < width


def test_a_group_is_left_out_of_its_own_form_error():
    of = drawn(FormError(1.0, 0.0, 0.0), 200)
    far = [Number(1.0, 3.0, 1.0, 0.001, "far", 0.1) for _ in range(30)]
    forms = {n.group: form for n, form in left_out(of + far)}
    assert forms["far"] == form_error(of)
    assert forms["0"] == form_error([n for n in of + far if n.group != "0"])
    assert forms["0"] != forms["far"]


def test_where_nothing_covers_the_widest_is_taken():
    assert form_error([Number(1.0, 100.0, 1.0, 0.001, "", 0.1)]) == FormError(8.0, 0.34, 1.0)


def test_a_deviation_is_of_chance_and_both_forms():
    # 2 0.3, 0.1 2 and 0.5 0.4 2.
    assert FormError(2.0, 0.1, 0.5).sd(2.0, 0.3, 0.4) == pytest.approx(math.hypot(0.6, 0.2, 0.4))


def test_the_numbers_of_a_case_are_those_of_the_true_set_beside_the_truth():
    values = {"steering_gain": {"gain": 0.8}, "": {"clock_offset": 0.0}}
    own = hypothesis(
        ("steering_gain",), [5.0, 5.0], 0.1, values=values, z=[-1.0, 0.0], sd=[0.1, 0.2]
    )
    other = hypothesis(("wind",), [9.0, 9.0], 0.6)
    concealed = {"steering_gain": {"gain": 0.75}}
    told = entry(0, concealed, [hypothesis((), [10.0, 10.0], 0.5), own, other])
    [number] = scored_numbers([told])
    assert (number.value, number.size, number.spread) == (-1.0, -1.0, 0.1)
    assert number.true < 0  # it turns less than neutral
    assert number.share == pytest.approx(0.1 / 0.4)  # left, over what is closed
    assert scored_numbers([entry(1, ["payload"], [own, other])]) == []  # the truth was not fitted
