import math
from dataclasses import replace

import pytest
import torch
from scipy.optimize import minimize

from buggy_rl.estimation.gauss_newton import DAMPINGS, Fit, _steps, _within, fitted
from tests.diagnosis.planted import FEW, problem_of

UPHILL = 9  # a seed of such a step


def fit(problem, *effects):
    [found] = fitted(problem, [problem.library.hypothesis(effects)])
    return found.values()


def test_a_planted_effect_is_recovered_and_a_wrong_one_does_not_explain_it(late):
    problem, (right, wrong) = late
    assert right.values()["steering_dead_time"]["dead_time"] == pytest.approx(0.06, rel=0.05)
    assert abs(right.values()[""]["clock_offset"]) < 0.005
    assert float(right.square.mean()) / 60 == pytest.approx(1.0, abs=0.15)
    assert problem.cost(wrong) > problem.cost(right) + 100


def test_two_effects_of_one_hypothesis_are_told_apart(drives):
    both = fit(problem_of(drives["two"]), "viscous_drag", "steering_gain")
    assert both["steering_gain"]["gain"] == pytest.approx(0.8, rel=0.03)
    assert both["viscous_drag"]["rate"] == pytest.approx(0.5, rel=0.1)


def test_a_parameter_of_the_simulators_own_is_recovered(drives):
    problem = problem_of(drives["heavy"], parameters=["drive_force"])
    assert problem.simulation.make(1).declared["drive_force"].value > 5.0
    found = fit(problem, "parameter:drive_force")
    assert found["parameter:drive_force"]["drive_force"] == pytest.approx(4.0, rel=0.03)


def test_what_is_known_of_derivatives_is_not_found_anew_and_leads_to_the_same_fit(drives):
    problem = problem_of(drives["heavy"], parameters=["drive_force"])
    name = ("parameter:drive_force", "drive_force")
    [base] = fitted(problem, [problem.library.hypothesis(name[:1])])
    begun = problem.library.at((name[0], "viscous_drag"), base.named())
    [anew] = fitted(problem, [begun])
    knowing = replace(problem, known={name: base.jacobian[..., 0]})
    [found] = fitted(knowing, [begun])
    assert torch.equal(found.jacobian[..., 0], base.jacobian[..., 0])
    assert not torch.equal(anew.jacobian[..., 0], base.jacobian[..., 0])
    assert problem.cost(found) == pytest.approx(problem.cost(anew), abs=0.5)
    rows = torch.arange(3)
    assert torch.equal(knowing[rows].known[name], base.jacobian[rows, :, 0])


def test_an_effect_is_neutral_on_recordings_of_the_same_simulator(drives):
    gain = fit(problem_of(drives["nothing"]), "steering_gain")
    assert gain["steering_gain"]["gain"] == pytest.approx(1.0, abs=0.02)


def test_values_stay_within_their_bounds_and_a_start_beyond_them_is_brought_in(late):
    problem, _ = late
    outside = problem.library.hypothesis(["steering_dead_time"], [-3.0, 0.0])
    [found] = fitted(problem, [outside], 1)
    assert found.values()["steering_dead_time"]["dead_time"] >= 0.0
    assert found.jacobian is not None
    assert found.jacobian.shape == (len(problem.segments), 60, 2)


def test_a_parameter_at_a_bound_is_reported(late):
    problem, (right, _) = late
    assert right.at_bound("steering_dead_time") == ()
    slippery = problem.library.hypothesis(["grip_patch"], [0.0, 0.0, 0.0, -99.0, 0.0])
    assert slippery.at(slippery.vector).at_bound("grip_patch") == ("grip",)


def test_the_cost_is_the_loss_of_all_segments_and_the_penalty_of_the_values(late):
    problem, (right, _) = late
    loss = problem.noise.loss(right.square, problem.dispersion)
    assert len(loss) == len(problem.segments) > 1
    assert right.penalty() > 0
    assert problem.cost(right) == pytest.approx(float(sum(loss)) + right.penalty())


def test_a_step_beyond_a_bound_goes_along_it_to_the_least_there(late):
    problem, _ = late
    start = problem.library.hypothesis(["steering_dead_time"], [0.5, 0.0])  # at least 0
    hessian = torch.tensor([[2.0, 1.5], [1.5, 2.0]], dtype=torch.float64)
    gradient = torch.tensor([2.0, 0.4], dtype=torch.float64)
    step = _within(start, hessian, gradient)
    assert float(start.vector[0] + step[0]) == pytest.approx(0.0)
    least = minimize(
        lambda s: gradient.numpy() @ s + 0.5 * s @ hessian.numpy() @ s,
        [0.0, 0.0],
        bounds=[(-0.5, None), (-5.0, 5.0)],
    )
    assert step.tolist() == pytest.approx(least.x.tolist(), abs=1e-4)


def test_hypotheses_far_behind_another_fit_are_fitted_no_further(drives):
    problem = problem_of(drives["two"])[torch.arange(3)]
    slow = problem.library.hypothesis(("tire_grip", "steering_gain"))
    rolled = []
    simulation = replace(problem.simulation, rolled=lambda *size: rolled.append(size))
    for leading in (-1e6, math.inf):
        fitted(replace(problem, simulation=simulation), [slow], 5, leading=leading)
        rolled.append(leading)
    short = rolled.index(-1e6)
    assert short < len(rolled) - short - 2


def test_a_fit_that_begins_at_its_end_rolls_out_no_step(late):
    problem, (right, _) = late
    asked = []
    simulation = replace(problem.simulation, rolled=lambda *size: asked.append(size))
    [again] = fitted(replace(problem, simulation=simulation), [right])
    assert len(asked) == 1
    assert torch.equal(again.vector, right.vector)


def test_a_step_that_its_bounds_lead_uphill_does_not_end_a_fit(late):
    """What bounds cut off several coordinates at once can make the rest of a step wrong."""
    problem, (fit, _) = late
    start = problem.library.hypothesis(FEW[1:])
    random = torch.Generator().manual_seed(UPHILL)
    count, size = len(start.vector), fit.whitened.shape
    three = torch.randn(*size, 3, generator=random, dtype=torch.float64)
    alike = three @ torch.randn(3, count, generator=random).double()
    jacobian = alike + 0.1 * torch.randn(*size, count, generator=random).double()
    wrong = jacobian @ (10 * torch.randn(count, generator=random).double())
    begun = Fit(start.effects, start.coordinates, start.vector, wrong, jacobian)
    assert len(_steps(problem, begun, DAMPINGS).ends) == len(DAMPINGS)
    assert len(_steps(problem, begun, DAMPINGS[:1]).ends) == len(DAMPINGS) - 1  # the damped ones
    right = replace(begun, whitened=torch.zeros_like(wrong))
    assert _steps(problem, right, DAMPINGS).ends == []
