"""Layers of a repaired simulator: each is kept for what it brings, and never all for less."""

import json
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.diagnosis.pipeline import open_case, run_diagnosis
from buggy_rl.diagnosis.repair.layers import (
    Layer,
    Layered,
    _at_least,
    _closeness,
    _discovered,
    _is_nearer,
    _more_missing,
    is_farther,
    is_worth,
    layered,
    probably_over,
)
from buggy_rl.diagnosis.repair.validation import (
    SAID,
    Errors,
    HeldOutResiduals,
    Stack,
    Validation,
    delivered,
    validated,
)
from buggy_rl.diagnosis.run.case import Criteria, Plenty, longer_segments
from buggy_rl.diagnosis.search import terms
from buggy_rl.effects.residual import ResidualAcceleration
from buggy_rl.effects.terms.grammar import PREFIX
from buggy_rl.estimation.evidence import blocks, misfit
from buggy_rl.estimation.gauss_newton import Problem
from buggy_rl.estimation.hypothesis import Library
from buggy_rl.estimation.noise_model import noise_model
from buggy_rl.estimation.residual_process import Recipe
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import cut_segments
from tests.diagnosis.planted import planted_drives, problem_of, single_track

ASKED = DiagnosisConfig(
    simulator="single_track",
    recordings=["made in the test"],
    output="nowhere",
    effects=["throttle_gain", "viscous_drag"],
    parameters=False,
    stretches=24,
    minutes=0.0,
    workers=1,
)
TORQUE_STEER = {"torque_steer": {"offset": 0.01}}  # which the library that is asked has not


pytestmark = pytest.mark.usefixtures("with_layers")


@pytest.fixture(scope="module", params=[1, pytest.param(terms.ROUNDS, marks=pytest.mark.slow)])
def found(with_layers, request):
    """What is said of a car whose motor turns it, after so many rounds of terms."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(terms, "ROUNDS", request.param)
        return run_diagnosis(ASKED, planted_drives([TORQUE_STEER], cars=2, seconds=14.0)[0]).answer


def test_what_has_no_name_gets_an_equation(found):
    [layer] = [layer for layer in found.layers if layer.kind == "terms"]
    assert layer.kept
    assert layer.gain > layer.error
    assert all(name.startswith(PREFIX) for name in layer.names)
    assert set(layer.names) <= set(found.repair.values)


def test_the_stack_is_nearer_than_the_simulator_and_no_farther_than_what_is_simpler(found):
    median = {name: of[SAID] for name, of in found.proof.median.items()}
    after = median.pop("after")
    assert after < 0.2 * median["before"]
    assert after < min(median.values()) + 2e-3  # which of two good ones is nearer is not sure


def test_a_term_is_an_effect_of_the_answer_with_equation_number_and_interval(found):
    written = [e for e in found.to_dict()["effects"] if e["kind"] == "term"]
    assert [t["name"] for t in written] == [t.name for t in found.terms]
    for term in written:
        [(name, number)] = term["parameters"].items()
        assert name == "coefficient"
        assert number["low"] < number["value"] < number["high"]
        open_ = number["low"] < 0.0 < number["high"]
        assert term["undetermined"] == [name] * open_
        assert term["equation"]
        assert term["sentence"].startswith("it behaves as if ")


def test_layers_are_in_the_answer_in_their_order(found):
    kinds = [layer["kind"] for layer in found.to_dict()["layers"]]
    order = ["effects", "parameters", "terms", "residual"]
    assert kinds == [kind for kind in order if kind in kinds]


def test_a_term_stands_for_an_effect_and_not_for_a_parameter_of_the_simulator():
    library = Library(["steering_lag"], single_track(1).declared)
    effects = ("parameter:mass", "steering_lag", "term.yaw.throttle")
    fit = library.hypothesis(effects)
    one = terms._without_one(
        SimpleNamespace(library=library), SimpleNamespace(effects=effects, fit=fit)
    )
    assert [h.effects for h in one] == [effects[:1] + effects[2:], effects[:2]]


def test_where_nothing_is_wrong_nothing_is_laid_on():
    answer = run_diagnosis(ASKED, planted_drives([{}], cars=2, seconds=14.0)[0]).answer
    assert [layer for layer in answer.layers if layer.kept] == []
    assert answer.more < 0.5
    assert answer.repair.values == {}
    assert answer.repair.residual is None
    assert answer.terms == []


@pytest.mark.parametrize("missing", [{}, TORQUE_STEER])
def test_only_terms_that_promise_something_are_fitted(missing, monkeypatch):
    monkeypatch.setattr(terms, "ROUNDS", 1)
    case = open_case(ASKED, planted_drives([missing], cars=2, seconds=14.0)[0])
    nothing = case.problem.library.hypothesis(())
    found = _discovered(case.problem, case.criteria, nothing, 24)
    assert bool(found.rounds[0]) == bool(missing)
    assert len(found.ranked) == 30  # they were screened in any case
    if not missing:
        assert found.best is found.base


def errors(size: float) -> Errors:
    return Errors(median={SAID: size}, sensed=torch.full((8,), size**2))


@pytest.fixture(scope="module")
def validation():
    return Validation(problem_of(planted_drives([{}], cars=2, seconds=8.0)[0]))


def alone(validation):
    """Stacks of which one is a learned residual alone."""
    nothing = [validation.problem.library.hypothesis(()).as_stamped] * len(validation.aside)
    return {"black_box": Stack(nothing, HeldOutResiduals([], Recipe(1.0)))}


def test_distances_are_of_the_segments_that_are_fitted_to_however_short_they_are():
    [drives] = planted_drives([{}], cars=2, seconds=6.0)
    given, segments = Simulation(single_track), cut_segments(drives, 0.5, 0.5)
    problem = Problem(given, segments, noise_model(given, segments), Library([]))
    validation = Validation(problem, longer_segments(drives, 0.5))
    nothing = [problem.library.hypothesis(()).as_stamped] * len(validation.aside)
    found = validation.errors({"before": Stack(nothing)})["before"]
    assert SAID in found.median  # of longer ones, which are fewer
    assert len(found.distance) == len(found.sensed) == len(segments)


@pytest.mark.parametrize("nearest", ["before", "retuned", "black_box"])
def test_what_anyone_would_try_first_is_delivered_where_it_is_nearer(validation, nearest):
    count = len(validation.problem.segments)
    of = {
        n: Errors({}, {SAID: 3.0}, sensed=torch.full((count,), 9.0)) for n in ("before", "retuned")
    }
    of |= {"black_box": of["before"]}
    of[nearest] = Errors({}, {SAID: 1.0}, sensed=torch.full((count,), 1.0))
    named = validation.problem.library.hypothesis(["viscous_drag"]).as_stamped
    stack = Layered((), named, None, Errors({}, {SAID: 2.0}, sensed=torch.full((count,), 4.0)))
    best = _at_least(stack, validation, alone(validation), of)
    assert best.errors is of[nearest]
    assert (best.residual is not None) is (nearest == "black_box")
    assert "viscous_drag" not in best.start.effects


def test_a_stack_that_is_nearest_stays(validation):
    count = len(validation.problem.segments)
    named = validation.problem.library.hypothesis(["viscous_drag"]).as_stamped
    stack = Layered((), named, None, Errors({}, {SAID: 1.0}, sensed=torch.full((count,), 1.0)))
    far = Errors({}, {SAID: 3.0}, sensed=torch.full((count,), 9.0))
    every = {"before": far, "retuned": far, "black_box": far}
    assert _at_least(stack, validation, alone(validation), every) is stack


def test_what_is_named_is_delivered_where_it_surely_brings_rollouts_nearer(validation):
    """Cars with nothing wrong: a name that was given all the same closes nothing."""
    problem = validation.problem
    named = problem.library.hypothesis(["viscous_drag"])
    stacks, errors = validated(validation, named)
    criteria = Criteria(blocks(problem.segments))
    done = layered(validation, criteria, named, stacks, errors, "after")
    assert done.layers[0].names == ("viscous_drag",)
    assert not done.layers[0].kept
    assert "viscous_drag" not in done.start.effects


def test_closeness_counts_in_noise_and_one_spin_for_no_more_than_its_cap():
    noise, twice, spin = _closeness(Errors(sensed=torch.tensor([0.0, 4.0e4, 1e9])))
    assert noise == 0
    assert float(spin) == pytest.approx(float(twice))


def test_that_more_is_missing_is_said_with_its_probability(found):
    assert found.more > 0.9
    assert found.to_dict()["more_is_missing"] == found.more
    [line] = [line for line in found.lines() if line.startswith("More is missing than ")]
    assert f"probability {min(found.more, 0.99):.0%}: with " in line


@pytest.mark.parametrize(
    ("mean", "error", "count", "low", "high"),
    [
        (0.5, 0.1, 6, 0.99, 1.0),
        (0.02, 0.1, 6, 0.49, 0.51),  # at what it is compared with
        (-0.5, 0.1, 6, 0.0, 0.01),
        (0.5, 0.0, 1, 0.5, 0.5),  # of one block nothing is known
    ],
)
def test_a_gain_is_probable_by_its_error_over_blocks(mean, error, count, low, high):
    assert low <= probably_over(0.02, mean, error, count) <= high


@pytest.mark.parametrize(
    ("gain", "error", "worth"),
    [
        (0.3, 0.2, True),
        (0.3, 0.4, False),  # within its standard error
        (0.01, 0.001, False),  # sure, and too little
    ],
)
def test_a_gain_counts_where_it_is_sure_and_large_enough(gain, error, worth):
    assert is_worth(gain, error) is worth


@pytest.mark.parametrize(
    ("ratios", "farther"),
    [
        ([1.3] * 12, True),
        ([0.7] * 12, False),
        ([1.01] * 12, False),  # by less than counts
        # Most are farther, and the median with them; the mean is not, for its standard error.
        ([1.2] * 7 + [0.2] * 5, False),
    ],
)
def test_a_layer_is_farther_by_pairs_of_segments(ratios, farther):
    group = torch.arange(12)
    distance = torch.linspace(0.01, 0.02, 12)
    without, with_it = Errors(distance=distance), Errors(distance=distance * torch.tensor(ratios))
    assert is_farther(with_it, without, group) is farther


def test_what_is_farther_within_a_millimetre_is_not_farther():
    near = Errors(distance=torch.full((12,), 1e-4)), Errors(distance=torch.full((12,), 9e-4))
    assert not is_farther(near[1], near[0], torch.arange(12))


@pytest.mark.parametrize(
    ("sensed", "distance", "nearer"),
    [
        (1.0, 2.0, True),  # in all channels
        (4.0, 1.0, True),  # by its distance, and alike in all channels
        (4.0, 2.0, False),
        (9.0, 1.0, False),  # by its distance, and farther in all channels
    ],
)
def test_nearer_is_in_all_channels_or_by_distance(sensed, distance, nearer):
    group = torch.arange(12) % 4

    def errors(median, sensed, distance):
        each = 1.0 + 0.01 * torch.arange(12) / 12
        return Errors({}, {SAID: median}, sensed=sensed * each, distance=distance * each)

    assert _is_nearer(errors(1.0, sensed, distance), errors(2.0, 4.0, 2.0), group) is nearer


@pytest.mark.parametrize(("median", "nearer"), [(0.0040, False), (0.0030, True)])
def test_what_is_nearer_by_less_than_a_millimetre_takes_no_explanation_away(median, nearer):
    group = torch.arange(12) % 4
    simple, stack = (
        Errors({}, {SAID: m}, sensed=torch.full((12,), s), distance=torch.full((12,), m))
        for m, s in ((median, 1.0), (0.0045, 4.0))
    )
    assert _is_nearer(simple, stack, group) is nearer


def test_a_residual_learns_from_a_baseline_too_where_that_brings_rollouts_nearer():
    same, right = planted_drives([TORQUE_STEER, {}], cars=4, seconds=9.0)
    few, more = same[:2], {"wrong as well": same[2:], "right": right[2:]}
    problem = problem_of(few)
    learned = {
        name: Validation(problem, plenty=plenty(few, drives)).residuals()
        for name, drives in more.items()
    }
    assert learned["wrong as well"].recipe.baseline
    assert not learned["right"].recipe.baseline
    nothing = problem.library.hypothesis(())
    alone = Validation(problem).residuals().recipe
    both = learned["wrong as well"].recipe
    fresh = problem_of(planted_drives([TORQUE_STEER], cars=2, seconds=9.0, seed=5)[0])
    near, far = (
        misfit(_rolled(delivered(problem, nothing, 2, recipe, plenty(few, same[2:])), fresh))
        for recipe in (both, alone)
    )
    assert near < 0.9 * far


def plenty(drives, baseline):
    return Plenty(*(cut_segments(each, 1.0, 1.0) for each in (drives, baseline)))


def _rolled(file, fresh):
    """Squares [N] of rollouts of a delivered residual over fresh drives."""
    effect = ResidualAcceleration(model=file.residual, strength=1.0, dt=fresh.segments.dt)
    simulation = replace(fresh.simulation, standing=(effect,))
    return fresh.noise.whiten(simulation.residuals(fresh.segments))[0].square().mean(-1)


def test_a_tenth_of_what_is_named_is_no_more_that_is_missing():
    def errors(distance):  # [deviations of the sensor] of eight blocks, a little apart
        sensed = (distance * torch.linspace(0.98, 1.02, 8)).square()
        return Errors(square=sensed, sensed=sensed)

    group, end = torch.arange(8), errors(2.0)
    start = SimpleNamespace(effects=())
    kept = (Layer("parameters", (), 0.1, 0.01, True, {}, 8),)
    found = Layered(kept, start, None, end)
    little = errors(2.2)
    # The same gain upon the names: all that there is, or beside what is named.
    assert _more_missing(little, little, found, group) > 0.9
    assert _more_missing(errors(20.0), little, found, group) < 0.1
    assert _more_missing(errors(20.0), errors(8.0), found, group) > 0.9


def test_a_layer_of_diagnosis_json_is_the_layer_that_was_written():
    layer = Layer("terms", ("term.yaw.throttle",), 0.2, 0.05, True, {0.3: 0.01, 1.0: 0.04})
    assert Layer.of(json.loads(json.dumps(layer.to_dict()))) == layer
