import pytest
import torch

from buggy_rl.diagnosis.residuals import CONDITIONS
from buggy_rl.diagnosis.run.case import Criteria
from buggy_rl.diagnosis.search.candidate import Candidate, Variation, conditions, variation
from buggy_rl.diagnosis.search.posterior import STEADY
from buggy_rl.estimation.evidence import blocks, cross_validated
from buggy_rl.estimation.gauss_newton import Problem, fitted
from tests.diagnosis.planted import planted_drives, problem_of

SAME = STEADY

DRAGS = [
    {"viscous_drag": {"rate": 0.5}},
    {"aerodynamic_drag": {"coefficient": 0.25}},
]


@pytest.fixture(scope="module")
def problems():
    """Of a car with linear and of one with quadratic drag."""
    return [problem_of(recordings) for recordings in planted_drives(DRAGS)]


def candidates(problem: Problem, effect: str) -> list[Candidate]:
    """The simulator as given, and with an effect."""
    starts = [problem.library.hypothesis(effects) for effects in ((), (effect,))]
    fits = fitted(problem, starts)
    known = cross_validated(problem, fits, blocks(problem.segments))
    return [Candidate(fit, cv) for fit, cv in zip(fits, known, strict=True)]


def varied(problem: Problem, effect: str) -> Variation:
    null, best = candidates(problem, effect)
    return variation(Criteria(blocks(problem.segments)), problem, best, null, effect)


def test_the_parameter_of_the_right_effect_is_constant(problems):
    assert varied(problems[0], "viscous_drag").closes < SAME


def test_the_parameter_of_a_misspecified_effect_varies_with_a_condition(problems):
    # c v^2 in place of k v: k = c v.
    found = varied(problems[1], "viscous_drag")
    assert found.condition == "vx"
    assert found.closes > SAME
    assert found.nats > 0


def test_the_constancy_test_rolls_nothing_out(problems, monkeypatch):
    problem = problems[1]
    null, best = candidates(problem, "viscous_drag")
    monkeypatch.setattr(Problem, "whitened", None)
    criteria = Criteria(blocks(problem.segments))
    assert variation(criteria, problem, best, null, "viscous_drag").nats > 0


def test_conditions_are_standardised_about_their_median(problems):
    segments, simulation = problems[0].segments, problems[0].simulation
    found = conditions(segments, simulation.instants(segments))
    assert set(found) == set(CONDITIONS) - {"heading"}  # its sine and cosine
    for value in found.values():
        assert value.shape == (len(segments),)
        assert float(value.median()) == pytest.approx(0.0, abs=1e-9)
        assert float(value.abs().max()) <= 3.0


def test_how_fast_the_steering_moves_is_a_mean_magnitude(problems):
    segments, simulation = problems[0].segments, problems[0].simulation
    rows = segments.start + simulation.instants(segments)
    moved = segments.action[:, rows, 1] - segments.action[:, rows - 10, 1]
    rate = moved.abs().double().mean(1)
    expected = ((rate - rate.median()) / rate.std()).clamp(-3.0, 3.0)
    found = conditions(segments, simulation.instants(segments))["steering_rate"]
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-5)


def test_what_is_equal_in_all_segments_is_no_condition(problems):
    same = problems[0].segments[torch.zeros(3, dtype=torch.long)]
    assert conditions(same, problems[0].simulation.instants(same)) == {}
