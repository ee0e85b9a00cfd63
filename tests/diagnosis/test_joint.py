"""Joint search: pairs are found in one go, and the evidence names what was planted."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from buggy_rl.diagnosis.run.budget import FULL, smaller
from buggy_rl.diagnosis.run.case import Criteria
from buggy_rl.diagnosis.search import joint
from buggy_rl.diagnosis.search.joint import MOST, joint_search
from buggy_rl.diagnosis.search.ways import unit_changes
from buggy_rl.estimation.evidence import blocks
from buggy_rl.estimation.sparse import trials
from tests.diagnosis.planted import FEW, problem_of

PRICE = 3.0  # [nats] of an effect more: odds of 20 to 1 against each


PLANTED = ["steering_dead_time", "steering_gain", "viscous_drag"]
SHORT = replace(FULL, rounds=1, iterations=2, refitted=0, sizes=(0.7,))


def searched(recordings, also=(), effects=FEW, budget=FULL):
    problem = problem_of(recordings, effects)
    return joint_search(problem, Criteria(blocks(problem.segments)), also, budget=budget)


@pytest.fixture(scope="module", params=["planted", pytest.param("few", marks=pytest.mark.slow)])
def found(drives, request):
    """Searches of what is planted anywhere, or of other effects as well."""
    names = ("nothing", "late", "draggy", "two")
    effects = {"planted": PLANTED, "few": FEW}[request.param]
    return {name: searched(drives[name], effects=effects) for name in names}


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("nothing", ()),
        ("late", ("steering_dead_time",)),
        ("draggy", ("viscous_drag",)),
        ("two", ("steering_gain", "viscous_drag")),
    ],
)
def test_the_most_evident_is_what_was_planted(found, name, expected):
    def priced(weighed):
        return weighed.evidence.log_evidence - PRICE * len(weighed.candidate.effects)

    assert max(found[name].weighed, key=priced).candidate.key == expected
    assert found[name].rank(expected) == (1 if expected else 0)


def test_a_right_hypothesis_leaves_noise_and_needs_nothing_beside_it(found):
    for name, expected in (("late", ("steering_dead_time",)), ("draggy", ("viscous_drag",))):
        [right] = [w for w in found[name].weighed if w.candidate.key == expected]
        [null] = [w for w in found[name].weighed if not w.candidate.key]
        assert right.evidence.spread <= 0.02
        assert right.evidence.variation <= 0.05
        assert right.evidence.dispersion < 1.5
        assert null.evidence.log_evidence < right.evidence.log_evidence - 20


def test_so_many_of_each_size_are_fitted_and_what_is_asked_for_is_marked(drives):
    asked = ("gyro_bias", "steering_offset", "viscous_drag")
    more = searched(drives["late"], [asked], budget=SHORT)
    keys = [w.candidate.key for w in more.weighed]
    sizes = [len(key) for key in keys]
    assert sizes.count(0) == 1
    assert sizes.count(1) == 5  # as many as the library has
    assert sizes.count(2) >= FULL.fitted[2]
    assert sizes.count(3) >= FULL.fitted[3]
    assert max(sizes) <= MOST
    assert [w.candidate.key for w in more.weighed if w.asked] in ([asked], [])
    assert asked in keys


def test_every_effect_of_the_leading_set_was_left_out_once(found):
    for result in found.values():
        tried = {w.candidate.key for w in result.weighed}
        best = min(result.weighed, key=lambda w: -w.evidence.log_evidence).candidate.key
        for effect in best:
            assert tuple(e for e in best if e != effect) in tried


def test_unit_changes_are_by_direction_and_of_one_prior_scale(late):
    problem, _ = late
    base = problem.rolled_out([problem.library.hypothesis(())], True)[0]
    rolled = problem.rolled_out(trials(problem, base))
    ways, changes = unit_changes(base, rolled)
    owners = [effect for effect, _ in ways]
    assert sorted(owners) == sorted(problem.library.names)
    assert changes.shape == (*base.whitened.shape, len(owners))
    bias = next(t for t in rolled if t.effects == ("gyro_bias",))
    expected = (bias.whitened - base.whitened) / float(bias.vector[0])
    # The sensor's bias is linear: any trial gives the same change.
    cosine = torch.nn.functional.cosine_similarity(
        changes[..., owners.index("gyro_bias")].flatten(), expected.flatten(), 0
    )
    assert float(cosine) > 0.999  # towards the positive, whichever way the trial went


def test_the_least_budget_still_finds_a_single_effect(drives):
    problem, budget = problem_of(drives["late"]), [*smaller()][-1]
    result = joint_search(problem, Criteria(blocks(problem.segments)), budget=budget)
    best = max(result.weighed, key=lambda w: w.evidence.log_evidence - 10 * len(w.candidate.key))
    assert best.candidate.key == ("steering_dead_time",)
    assert len(result.weighed) < 12


def test_what_there_is_no_time_for_is_left_out_and_said(drives):
    problem, asked = problem_of(drives["late"]), []
    budget = replace([*smaller()][-1], rounds=3, refitted=2)
    criteria = Criteria(blocks(problem.segments))
    result = joint_search(
        problem, criteria, budget=budget, admits=asked.append
    )  # None: for nothing
    assert asked == ["first_round", "refitted"]
    assert result.left_out == ("3 of at most 3 rounds", "fitting 2 sets on at the end")


class Restless:
    """A search of which another set leads after every round."""

    problem = None
    keys = iter([("wind",), ("gyro_bias",), ("payload",)])

    @property
    def leading(self):
        return SimpleNamespace(key=next(self.keys))


def test_rounds_end_when_time_is_up_and_sets_are_fitted_on_all_the_same():
    done, left_out = [], []

    def kept(name, _):
        done.append(name)
        return SimpleNamespace(state=lambda problem: state)

    state = Restless()
    joint._settled(state, None, lambda _: None, FULL, kept, lambda part: part != "round", left_out)
    assert done == ["round_0", "refitted"]
    assert left_out == ["4 of at most 5 rounds"]
