"""What differs, whatever the parameters are called: step tests of two simulators."""

import math
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from buggy_rl.diagnosis.answer.behaviour import Behaviour, behaviours, differing
from buggy_rl.diagnosis.answer.step_tests import Driven, _half_time, step_tests
from buggy_rl.diagnosis.search.posterior import FormError, shipped
from buggy_rl.estimation.hypothesis import Library
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.simulators import make_engine

DRIVEN = Driven(0.8, 1.5, 2.5, (-0.5, -0.3, -0.1), 0.2, 0.8, -1.0)
NAMES = [q.name for q in DRIVEN.quantities]


def quantities(effects=(), vector=(), **parameters):
    """Quantities of a single-track car by name."""

    def make(cars):
        return make_engine("single_track", cars, parameters=parameters or None)

    library = Library(["steering_dead_time", "sensor_latency", "throttle_dead_time"])
    hypothesis = library.hypothesis(effects, vector)
    rows = [(hypothesis, hypothesis.vector)]
    [row] = step_tests(Simulation(make), library, rows, DRIVEN, 0.01).tolist()
    return dict(zip(NAMES, row, strict=True))


def test_several_hypotheses_in_one_rollout_are_what_each_is_alone():
    library = Library(["steering_gain", "steering_dead_time"])
    rows = [
        (h, h.vector)
        for h in (
            library.hypothesis(()),
            library.hypothesis(["steering_gain"], [0.5, 1.0]),
            library.hypothesis(["steering_dead_time"], [0.7, 0.0]),
        )
    ]
    simulation = Simulation(lambda cars: make_engine("single_track", cars))
    together = step_tests(simulation, library, rows, DRIVEN, 0.01)
    alone = [step_tests(simulation, library, [row], DRIVEN, 0.01)[0] for row in rows]
    assert torch.allclose(together, torch.stack(alone), rtol=1e-5, equal_nan=True)
    assert float((together[1] - together[0])[0].abs()) > 1e-3


def coordinate(effect, value):
    [p] = Library([effect]).numbers(effect)
    return float(p.coordinate(value))


def test_half_of_the_way_is_found_between_rows():
    # 0, 0, 1, 4 of 4: half is 2, a third of the way from row 2 to row 3.
    values = torch.tensor([[0.0, 0.0, 1.0, 4.0], [0.0, 0.0, 0.0, 0.0]])
    found = _half_time(values, torch.tensor([4.0, 0.0]), 0.1).tolist()
    assert found[0] == pytest.approx(0.2 + 0.1 / 3)
    assert math.isnan(found[1])


def test_dead_time_latency_and_clock_add_up_in_the_response_to_a_steering_step():
    plain = quantities()
    late = quantities(["steering_dead_time"], [coordinate("steering_dead_time", 0.06), 0.0])
    assert late["steering_response"] - plain["steering_response"] == pytest.approx(0.06, abs=0.004)
    assert late["throttle_response"] == pytest.approx(plain["throttle_response"], abs=0.002)
    # The clock's scale is 10 ms: -2 is 20 ms earlier than stamped, for both commands.
    both = quantities(["sensor_latency"], [coordinate("sensor_latency", 0.05), -2.0])
    for name in ("steering_response", "throttle_response"):
        assert both[name] - plain[name] == pytest.approx(0.05 - 0.02, abs=0.006)


def test_the_curvature_is_that_of_the_road_wheel_angle_at_low_speed():
    # tan(0.3 * 0.8) / 0.174 m, less up to a fifth, since the front slips; mirrored to the right.
    found = quantities(left_angle=0.3, right_angle=0.3, steering_offset=0.0)
    rolling = math.tan(0.24) / 0.174
    assert 0.8 * rolling < found["left_curvature"] < rolling
    assert found["right_curvature"] == pytest.approx(-found["left_curvature"], rel=1e-3)
    assert found["straight_curvature"] == pytest.approx(0.0, abs=1e-4)
    assert found["coasting"] < 0 < found["acceleration"]


def test_with_less_grip_the_lateral_acceleration_is_smaller():
    # The tyres saturate: 0.3 g on both axles.
    less = quantities(front_grip=0.3, rear_grip=0.3)["lateral_acceleration"]
    assert less < 1.1 * 0.3 * 9.81 < 0.5 * quantities()["lateral_acceleration"]


def case_of(problem):
    return SimpleNamespace(
        problem=problem,
        given=problem.simulation,
        as_given=problem.library,
        retuned_from=None,
        about_given=lambda fit: fit,
    )


def found_of(fit, sd, *others):
    """What a search came to that cannot tell a fit from others, each with its probability."""
    covariance = sd**2 * torch.eye(len(fit.vector), dtype=torch.float64)
    validated = SimpleNamespace(covariance=covariance)
    best, *rivals = (
        SimpleNamespace(fit=f, key=f.effects, cross_validated=validated) for f in (fit, *others)
    )
    tried = {c.key: c for c in (best, *rivals)}
    return SimpleNamespace(
        best=best,
        described=best,
        tried=tried,
        most_probable=list(tried),
        posterior=SimpleNamespace(says="effects"),
    )


@pytest.fixture
def narrow(monkeypatch):
    """A form error of its own, whatever the shipped one is fitted to."""
    own = replace(shipped(), step_error=FormError(5.6, 0.03, 0.0))
    monkeypatch.setattr("buggy_rl.diagnosis.answer.behaviour.shipped", lambda: own)


@pytest.mark.usefixtures("narrow")
def test_what_an_effect_does_differs_and_what_it_does_not_does_not(late):
    problem, (dead_time, _) = late
    found = behaviours(case_of(problem), found_of(dead_time, 0.02))
    [first, *others] = differing(found)
    assert first.name == "steering_response"
    assert first.value - first.given == pytest.approx(0.06, abs=0.01)
    assert first.low < first.value < first.high < first.value + 0.03
    assert [b.name for b in others] == []
    assert {b.name for b in found} <= set(NAMES)


def test_nothing_differs_in_a_fit_that_may_be_anything(late):
    problem, (dead_time, _) = late
    assert differing(behaviours(case_of(problem), found_of(dead_time, 3.0))) == []


def test_no_interval_has_no_width(late):
    # Not even where leaving out blocks moves nothing: the form of the simulator is not the car's.
    problem, (dead_time, _) = late
    found = behaviours(case_of(problem), found_of(dead_time, 0.0))
    assert found
    form = shipped().step_error
    for b in found:
        size = max(abs(b.value), abs(b.given))
        assert b.high - b.low >= 2 * 1.96 * form.always * size * (1 - 1e-6)
        assert b.high > b.low


@pytest.mark.usefixtures("narrow")
def test_an_interval_holds_what_another_leading_hypothesis_says(late):
    # Without a dead time the clock takes what it may, 15 ms; with it 60 ms are the steering's.
    problem, (dead_time, gain) = late
    low = {}
    for others in ((), (gain,)):
        found = behaviours(case_of(problem), found_of(dead_time, 0.02, *others))
        [response] = [b for b in found if b.name == "steering_response"]
        low[others] = response.low - response.given
        assert response.differs == (low[others] > 0.01)  # 10 ms do not matter
    assert low[()] > 0.035
    assert -0.02 < low[gain,] < 0.016  # wider by the form error


def test_only_what_was_driven_is_tested(late):
    problem, (dead_time, _) = late
    segments = problem.segments
    never_left = segments.action.clone()
    never_left[..., 1] = -never_left[..., 1].abs()
    problem = replace(problem, segments=replace(segments, action=never_left))
    names = [b.name for b in behaviours(case_of(problem), found_of(dead_time, 0.02))]
    assert "right_curvature" in names
    assert "left_curvature" not in names
    assert "coasting" not in names  # the throttle is never off in these drives


def test_a_difference_is_said_with_its_interval():
    b = Behaviour("steering_response", "to half of the yaw rate", "s", 0.08, 0.14, 0.13, 0.15, True)
    assert b.line() == "to half of the yaw rate: car 140 ms (130 to 150), simulator 80 ms"


def test_the_clearest_difference_comes_first_whatever_its_size():
    far = Behaviour("far", "far", "m/s^2", 5.0, 6.0, 5.4, 6.6, True)  # 0.8 widths of its interval
    clear = Behaviour("clear", "clear", "m/s^2", 5.0, 5.4, 5.3, 5.5, True)  # 2 widths
    same = Behaviour("same", "same", "m/s^2", 5.0, 5.1, 4.9, 5.3, False)
    assert differing([far, same, clear]) == [clear, far]
