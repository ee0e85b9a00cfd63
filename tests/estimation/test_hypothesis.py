"""Hypotheses: their numbers stay within the parameters' bounds, also after rounding."""

import pytest

from buggy_rl.core.parameters import Parameter
from buggy_rl.estimation.hypothesis import OWN, PATCH_GRID, Library
from tests.diagnosis.planted import problem_of

ROUNDED_BELOW = [0.0037, 0.0074, 0.0101]


@pytest.mark.parametrize("value", ROUNDED_BELOW)
def test_a_parameter_at_its_bound_is_not_beyond_it(value):
    delay = Parameter("steering_dead_time", value, 0.0, 0.2, "s", "Delay.")
    library = Library([], {delay.name: delay})
    lowest = library.hypothesis([OWN + delay.name])
    lowest = lowest.at(lowest.vector - 100.0)
    assert lowest.values()[OWN + delay.name] == {delay.name: 0.0}
    settings = library.settings([(lowest, lowest.vector)])
    assert settings.parameters[delay.name].tolist() == [0.0]


def test_some_of_these_values_round_beyond_the_bound():
    def rounded(value):
        [own] = Library([], {"p": Parameter("p", value, 0.0, 0.2, "s", "")}).numbers(OWN + "p")
        return own.value_at(own.coordinate(0.0))

    assert min(map(rounded, ROUNDED_BELOW)) < 0


def test_an_effect_is_screened_both_ways_and_a_vector_in_each_of_its_parts(drives):
    segments = problem_of(drives["nothing"], []).segments
    library = Library(["steering_gain", "viscous_drag", "floor_slope", "grip_patch"])
    gain = library.trials("steering_gain", segments, (0.4, 1.5))
    assert sorted(gain) == [[-1.5], [-0.4], [0.4], [1.5]]
    assert sorted(library.trials("floor_slope", segments, (1.0,))) == [
        [-1.0, 0.0], [0.0, -1.0], [0.0, 1.0], [1.0, 0.0]
    ]  # fmt: skip
    assert len(library.trials("grip_patch", segments)) == len(PATCH_GRID) ** 2


@pytest.mark.parametrize(("value", "side"), [(0.2, -1), (0.199, -1), (0.1, 1), (0.0, 1)])
def test_a_parameter_of_the_simulators_own_is_probed_within_its_range(value, side):
    [own] = Library([], {"p": Parameter("p", value, 0.0, 0.2, "s", "")}).numbers(OWN + "p")
    assert own.probe * side > 0
    assert 0.0 <= value + own.probe <= 0.2
