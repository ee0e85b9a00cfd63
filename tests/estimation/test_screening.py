import math

import pytest
import torch

from buggy_rl.estimation.gauss_newton import Fit, Problem
from buggy_rl.estimation.noise_model import NoiseModel
from buggy_rl.estimation.sparse import _trials, promise, screened

UNIT = NoiseModel(torch.eye(6, dtype=torch.float64).expand(1, 6, 6), torch.ones(6))
PROBLEM = Problem(None, None, UNIT, None)  # type: ignore[arg-type]  # nothing is rolled out
FIRST, SECOND = torch.eye(6, dtype=torch.float64)[:2]


def fit(residual, jacobian=None):
    return Fit((), (), torch.zeros(0), residual[None], jacobian)


def loss(square):
    return 12 * math.log1p(square / 24)  # h/2 log(1 + r^2 / h), h = 4 * 6


@pytest.mark.parametrize(
    ("residual", "square"),
    [
        (0.6 * FIRST, 0.16),  # 1 + t (0.6 - 1) at the farthest t, 1.5: 0.4
        (-1.0 * FIRST, 0.0),  # the zero lies halfway
        (2.0 * FIRST, 1.0),  # leads away: no step at all
    ],
)
def test_a_trial_promises_the_best_point_on_its_line(residual, square):
    assert promise(PROBLEM, fit(FIRST), fit(residual)) == pytest.approx(loss(square))


def test_what_the_bases_own_parameters_absorb_is_no_promise():
    base = fit(FIRST + SECOND, SECOND[None, :, None])  # it may move along the second reading
    # The way to the trial along the second reading is the base's own: left is that of the first,
    # which ends at 1 - 1.5 * 0.4 = 0.4. The trial itself leaves 0.36 + 1.
    trial = fit(0.6 * FIRST + 1.0 * SECOND)
    assert promise(PROBLEM, base, trial) == pytest.approx(loss(0.16 + 1.0))
    along = fit(FIRST + 0.6 * SECOND)
    assert promise(PROBLEM, base, along) == pytest.approx(loss(1.0 + 0.36))  # the trial's own


def test_of_an_effects_trials_the_one_that_promises_most_is_kept(late):
    problem, _ = late
    [base] = problem.rolled_out([problem.library.hypothesis(())])
    [kept] = screened(problem, base, 1)
    assert kept.effects == ("steering_dead_time",)
    trials = problem.rolled_out(_trials(problem, base, "steering_dead_time"))
    costs = [promise(problem, base, trial) for trial in trials]
    assert max(costs) > min(costs) + 1.0
    assert promise(problem, base, kept) == pytest.approx(min(costs), rel=1e-6)


def test_a_limit_is_tried_where_it_is_reached(late):
    problem, _ = late
    far = [z for [z] in problem.library.trials("motor_power_limit", problem.segments, (0.4, 1.5))]
    [number] = problem.library.numbers("motor_power_limit")
    powers = [float(number.value_at(z)) for z in far]
    assert powers == pytest.approx([15 / (0.4 * 8 / 3), 15 / 4.0], rel=0.02)  # [W/kg]
    near = problem.library.trials("steering_dead_time", problem.segments, (0.4, 1.5))
    assert near == [[0.4], [1.5]]


@pytest.mark.parametrize(("effect", "clocks"), [("steering_dead_time", 2), ("tire_grip", 1)])
def test_effects_that_may_delay_are_tried_with_a_right_clock_too(late, effect, clocks):
    problem, _ = late
    [base] = problem.rolled_out([problem.library.hypothesis((), [1.0])])
    assert {float(trial.vector[-1]) for trial in _trials(problem, base, effect)} == (
        {0.0, 1.0} if clocks == 2 else {1.0}
    )
