"""Calibration: weights that are known are found, and groups that are left out are left out."""

import hashlib
from dataclasses import replace

import numpy as np
import pytest
import torch
import yaml

from buggy_rl.diagnosis.search.posterior import FormError, Posterior
from buggy_rl.proof.calibrate.calibration import (
    EARLIER,
    calibrated,
    case_folds,
    content,
    feature_table,
    group,
    left_out,
    weights,
)
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.equivalents import of_same_name
from buggy_rl.proof.ledger import Entry
from buggy_rl.proof.plants.composed import SORTS
from buggy_rl.proof.score.outcome import CaseAnswer
from buggy_rl.proof.score.tables import best_single, counted, listed, lowest_loss
from tests.diagnosis.observations import case, hypothesis

PLANTS = ("reference", "mujoco", "commonroad")


def entry(seed, concealed, hypotheses, first=1.0, baseline=True):
    values = concealed if isinstance(concealed, dict) else {name: {} for name in concealed}
    drawn = Case(seed, PLANTS[seed % 3], "reference", baseline, values)
    return Entry(drawn.id, opened=drawn, evidence=case(hypotheses, first))


def drawn(seed, chance):
    """A case with one effect, nothing or unknown physics, of which loss and excess tell."""
    kind = ("payload", "nothing", "unknown")[seed % 3]
    first = 0.02 if kind == "nothing" else 1.0
    left = {"payload": 0.03, "nothing": 0.02, "unknown": 0.6}[kind] * np.exp(chance.normal(0, 0.3))
    none = 50 + 100 * first
    gained = 100 * (first - left) if kind != "nothing" else chance.exponential(2.0)
    hypotheses = [
        hypothesis((), [none / 2] * 2, first),
        hypothesis(("payload",), [(none - gained) / 2] * 2, left),
        hypothesis(("wind",), [(none - 0.9 * gained) / 2] * 2, left + 0.1 * (first - left)),
    ]
    concealed = {"payload": ["payload"], "nothing": [], "unknown": [SORTS[seed % len(SORTS)]]}
    return entry(seed, concealed[kind], hypotheses, first)


@pytest.fixture(scope="module")
def cases():
    chance = np.random.default_rng(0)
    return [drawn(seed, chance) for seed in range(120)]


def test_left_out_cases_are_answered_rightly_where_something_tells(cases):
    found, mean = left_out(cases, 1.0)
    assert mean > -0.35  # a third for each of three kinds would be -1.1
    right = [e.scored(p).all_right for e, p in zip(cases, found, strict=True)]
    assert np.mean(right) > 0.95


def test_where_nothing_tells_right_from_wrong_nothing_is_learnt():
    chance = np.random.default_rng(1)
    blind = []
    for seed in range(90):
        concealed = [["payload"], ["wind"]][int(chance.integers(2))]
        same = [hypothesis((e,), [20.0, 20.0], 0.1) for e in ("payload", "wind")]
        blind.append(entry(seed, concealed, [hypothesis((), [60.0, 60.0], 1.0), *same]))
    found, _ = left_out(blind, 1.0)
    sure = [p.of("payload") for p in found]
    assert max(sure) < 0.6
    assert min(sure) > 0.4


def test_a_truth_that_was_not_fitted_cannot_be_learnt_from_and_counts_as_missed(cases):
    absent = entry(3, ["yaw_damping"], cases[0].seen.hypotheses)
    assert not feature_table([absent]).true.any()
    assert "0 % (0 to 79) of 1" in counted({"": [absent.scored(posterior_of(absent))]})
    with_it = [*cases, absent]
    for one, other in zip(
        weights(feature_table(cases), 1.0), weights(feature_table(with_it), 1.0), strict=True
    ):
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-6)


def test_features_that_tell_can_be_taken_out(cases):
    calibration, _ = calibrated(cases, without=["left", "share"])
    assert "left" not in calibration.hypothesis
    assert "left" not in calibration.unknown
    assert "share" not in calibration.unknown
    fits = ["left", "share", "first", "ratio", "blocks", "evidence"]  # how well one does
    fits += ["weakest", "weakest_blocks", "typical", "gained", "channel"]
    assert left_out(cases, 1.0, fits)[1] < left_out(cases, 1.0)[1] - 0.1
    with pytest.raises(ValueError, match="no feature wight; there are at_bound, baseline, "):
        feature_table(cases, ["wight"])


def posterior_of(e):
    sets = [h.effects for h in e.seen.hypotheses]
    return Posterior(dict.fromkeys(sets, 1 / len(sets)), 0.0)


def with_nats(e, nats):
    """A case of a later ledger: with a second evidence of each set."""
    known = [replace(h, changed=nats[h.effects]) for h in e.seen.hypotheses]
    return replace(e, evidence=replace(e.seen, hypotheses=tuple(known)))


@pytest.fixture(scope="module")
def later(cases):
    """Other cases, of which the second evidence tells the truth and nothing else does."""
    found = []
    for e in cases[:60]:
        nats = {(): -30.0, ("payload",): -30.0, ("wind",): -30.0}
        nats[e.case.truth if not e.case.unknown else ()] = 0.0
        found.append(with_nats(e, nats))
    return found


def test_weights_of_earlier_ledgers_are_the_mean_of_the_prior_of_later_ones(cases, later):
    earlier = weights(feature_table(cases[60:]), EARLIER)
    stiff = weights(feature_table([*later, *cases[60:]]), 1e9)
    for a, b in zip(earlier, stiff, strict=True):
        torch.testing.assert_close(a, b, atol=1e-3, rtol=1e-3)
    loose = feature_table([*later, *cases[60:]])
    names, _ = loose.names
    told = dict(zip(names, weights(loose, 0.1)[0].tolist(), strict=True))
    assert told["changed"] > 0.1


def test_what_later_ledgers_tell_is_counted_on_them_alone(cases, later):
    found, mean = left_out([*later, *cases[60:]], 1.0)
    truths = [
        p.unknown if e.case.unknown else p.sets[e.case.truth]
        for e, p in zip(later, found, strict=False)
    ]
    # The posterior keeps `lapse` for what no case showed.
    assert mean == pytest.approx(np.log(truths).mean(), abs=0.03)


def test_a_group_is_left_out_as_a_whole(cases):
    part = case_folds(cases).tolist()
    of_group: dict[str, set[int]] = {}
    for e, number in zip(cases, part, strict=True):
        of_group.setdefault(group(e.case), set()).add(number)
    assert all(len(parts) == 1 for parts in of_group.values())
    assert len(of_group) > 8
    assert len({*part}) == 8


def test_the_file_says_what_it_was_made_from_and_gives_the_same_answers(cases, tmp_path):
    ledger = tmp_path / "ledger.jsonl"
    ledger.write_text("x")
    calibration, ridge = calibrated(cases)
    form = FormError(2.0, 0.05, 0.3)
    read = yaml.safe_load(content(calibration, form, [ledger], len(cases), ridge))
    assert read["made_from"]["ledgers"] == {"ledger.jsonl": hashlib.sha256(b"x").hexdigest()}
    assert read["made_from"]["cases"] == 120
    assert read["hypothesis"] == dict(calibration.hypothesis)
    assert read["form_error"] == {"chance": 2.0, "always": 0.05, "remains": 0.3}
    assert cases[0].posterior(calibration).best == ("payload",)


def test_what_is_named_is_counted_by_hand():
    none, one, two = (
        hypothesis(e, [10.0, 10.0], 0.5) for e in ((), ("payload",), ("payload", "wind"))
    )
    right = entry(0, ["payload"], [none, one, two])
    nothing = entry(1, [], [none, one])
    outside = entry(2, [SORTS[0]], [none, one])
    said = [
        Posterior({(): 0.1, ("payload",): 0.7, ("payload", "wind"): 0.2}, 0.0),
        Posterior({(): 0.4, ("payload",): 0.6}, 0.0),
        Posterior({(): 0.1, ("payload",): 0.2}, 0.7),
    ]
    scored = [e.scored(p) for e, p in zip([right, nothing, outside], said, strict=True)]
    table = counted({"posterior": scored})
    rows = {
        "one effect: first name right": "100 %",
        "one effect: and nothing else said": "100 %",
        "nothing: a name above 0.5": "100 %",
        "no effect describes it: a name above 0.5": "0 %",
        "no effect describes it: called unknown": "100 %",
        "no effect describes it: called nothing": "0 %",
    }
    for name, figure in rows.items():
        assert f"| {name} | {figure}" in table
    assert listed(scored[0]) == [(pytest.approx(0.9), True), (pytest.approx(0.2), False)]
    # 0.1^2, 0.2^2, 0.6^2 and 0.2^2 of four names.
    assert "| Brier score of all listed names | 0.113 |" in table


def test_a_parameter_that_is_the_same_as_an_effect_counts_as_that_effect():
    own, other = ("parameter:steering_dead_time",), ("parameter:mass", "steering_dead_time")
    assert [of_same_name(*own), *map(of_same_name, other)] == ["steering_dead_time", *other]
    late = [hypothesis(e, [5.0, 5.0], 0.1) for e in (own, ("steering_dead_time",), other)]
    e = entry(0, ["steering_dead_time"], [hypothesis((), [10.0, 10.0], 0.5), *late])
    assert feature_table([e]).true.tolist() == [[False, True, True, False, False]]
    said = Posterior({(): 0.1, own: 0.5, ("steering_dead_time",): 0.3, other: 0.1}, 0.0)
    mentioned = {"parameter:mass": 0.1, "steering_dead_time": pytest.approx(0.9)}
    assert CaseAnswer.of(said).probable == mentioned
    assert "| one effect: and nothing else said | 100 %" in counted({"": [e.scored(said)]})


@pytest.mark.parametrize(
    ("seed", "concealed", "baseline", "form"),
    [
        (0, [], False, False),
        (1, [], False, True),
        (1, [], True, False),
        (1, ["wind"], False, False),
    ],
)
def test_a_simulator_of_another_make_differs_in_form_where_no_baseline_closes_that(
    seed, concealed, baseline, form
):
    none, wind = (hypothesis(e, [10.0, 10.0], 0.5) for e in ((), ("wind",)))
    # Seed 0 is the reference car's own simulator.
    e = entry(seed, concealed, [none, wind], baseline=baseline)
    assert (e.case.unknown, e.case.family == "unknown") == (form, False)
    nothing, effect, other = feature_table([e]).true[0].tolist()
    assert (nothing, effect, other) == (not concealed and not form, bool(concealed), form)


def test_the_best_single_effect_is_named_whatever_a_pair_would_do():
    pair = hypothesis(("payload", "wind"), [1.0, 1.0], 0.1)
    alone = hypothesis(("payload",), [5.0, 5.0], 0.3)
    found = best_single(entry(0, [], [hypothesis((), [10.0, 10.0], 0.5), alone, pair]))
    assert found.sets == {("payload",): 1.0}


def test_the_lowest_loss_is_named_without_a_doubt():
    better = hypothesis(("payload",), [5.0, 10.0], 0.1)
    found = lowest_loss(entry(0, [], [hypothesis((), [10.0, 10.0], 0.5), better]))
    assert found.best == ("payload",)
    assert found.of("payload") == 1
