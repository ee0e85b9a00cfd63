from types import SimpleNamespace

import pytest
import torch

from buggy_rl.diagnosis.search import State, pruned
from buggy_rl.diagnosis.selection import Criteria, overlap
from buggy_rl.estimation.gauss_newton import Fit, Problem
from buggy_rl.estimation.hypothesis import Library
from buggy_rl.estimation.misfit import BaselineMisfit
from buggy_rl.estimation.noise_model import NoiseModel


def _candidate(effects, excess):
    """Leaves the same excess over the noise in each of four segments."""
    return SimpleNamespace(effects=effects, held_out=torch.full((4,), (1 + excess) ** 2))


def _kept(excesses, usual=0.0):
    """What pruning keeps of the longest hypothesis, by the excess that each leaves."""
    tried = {effects: _candidate(effects, excess) for effects, excess in excesses.items()}
    criteria = Criteria(torch.zeros(4), usual=BaselineMisfit(usual))
    state = State(None, tried)  # type: ignore[arg-type]
    return pruned(state, tried[max(excesses, key=len)], criteria)[1].effects


def test_a_further_effect_that_closes_less_than_the_rest_is_pruned():
    excesses = {(): 5.0, ("large",): 1.0, ("small",): 4.6}
    assert _kept(excesses | {("large", "small"): 0.6}) == ("large",)
    assert _kept(excesses | {("large", "small"): 0.4}) == ("large", "small")


def test_the_baseline_misfit_does_not_count_as_rest():
    excesses = {(): 5.0, ("large",): 1.0, ("small",): 4.6, ("large", "small"): 0.6}
    assert _kept(excesses, usual=0.3) == ("large", "small")


def test_the_first_effect_stays_whatever_the_rest():
    excesses = {(): 5.0, ("a",): 4.0, ("b",): 4.5, ("a", "b"): 3.8}
    assert _kept(excesses) == ("a",)


def test_the_smallest_effect_is_pruned_first_and_the_others_are_compared_without_it():
    excesses = {(): 5.0, ("a",): 1.2, ("b",): 2.0, ("c",): 4.9, ("a", "b"): 0.5, ("a", "c"): 1.1,
                ("b", "c"): 1.9, ("a", "b", "c"): 0.4}  # fmt: skip
    assert _kept(excesses) == ("a", "b")


def test_the_overlap_is_the_share_of_the_square_that_the_others_close_likewise():
    # Of one segment's residuals, drag closes 2 of the first and wind 2 of that and 1 of another.
    of = Library(effects=("viscous_drag", "wind")).hypothesis(("viscous_drag", "wind"))
    jacobian = torch.eye(6, dtype=torch.float64)[:, [0, 0, 1, 2]]  # drag; wind along x, y; clock
    vector = torch.tensor([2.0, 2.0, 1.0, 0.0], dtype=torch.float64)
    fit = Fit(of.effects, of.coordinates, vector, torch.zeros(1, 6), jacobian[None])
    noise = NoiseModel(torch.eye(6, dtype=torch.float64).expand(1, 6, 6), torch.ones(6))
    problem = Problem(None, None, noise, of)  # type: ignore[arg-type]  # nothing is rolled out
    assert overlap(problem, fit, {"viscous_drag"}) == pytest.approx(4 / 5)
    assert overlap(problem, fit, set()) == 0.0
