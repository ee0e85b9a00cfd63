"""Right against unknown: told apart where they differ, and not where they do not."""

import numpy as np
import pytest

from buggy_rl.diagnosis.search.candidate import Variation
from buggy_rl.estimation.evidence import Evidence
from buggy_rl.proof.calibrate.discrimination import USED, area, discrimination, left_out, samples
from buggy_rl.proof.cases.draw import DrawConfig, draw_all
from buggy_rl.proof.ledger import Entry
from buggy_rl.proof.plants import PLANTS, abilities
from tests.diagnosis import observations

CASES = draw_all(
    DrawConfig(cases=120, families=["one", "composed"]), {p: abilities(p) for p in PLANTS}
)


def hypothesis(effects, excess, evident, varies):
    return observations.hypothesis(
        effects,
        [1.0],
        excess,
        unclosed=max(0.0, excess),
        varies={effect: Variation("vx", varies, 1.0) for effect in effects},
        evidence=Evidence(evident, 0.0, 0.0, 1.0, evident, 0.0, 0.0, 500.0),
    )


def logged(seed, apart, first=1.0):
    """Cases in which a right effect closes nearly all, and a wrong one half."""
    chance = np.random.default_rng(seed)
    found = []
    for case in CASES:
        known = case.family == "one"
        truth = case.truth if known else ("steering_gain",)
        left = (0.05 if known else 0.5) if apart else 0.3
        left *= float(np.exp(chance.normal(0, 0.3)))
        sets = [
            hypothesis((), first, -300.0, 0.0),
            hypothesis(truth, left, -100 * left, 0.01),
        ]
        found.append(Entry(case.id, opened=case, evidence=observations.case(sets, first)))
    return found


def test_what_differs_is_told_apart_and_what_does_not_is_not():
    for apart, low, high in ((True, 0.98, 1.0), (False, 0.3, 0.7)):
        found = samples(logged(1, apart))
        right = np.array([s.right for s in found])
        assert low <= area(left_out(found, USED["all"]), right) <= high
    assert "all: 1.000" in discrimination(logged(1, True))


def test_a_case_in_which_nothing_shows_tells_nothing():
    assert not samples(logged(1, True, first=0.01))
    assert "too few" in discrimination(logged(1, True, first=0.01))
    assert "too few" in discrimination([])


def test_the_area_is_the_chance_that_a_right_one_scores_more():
    scores, right = np.array([0.1, 0.4, 0.35, 0.8]), np.array([False, False, True, True])
    assert area(scores, right) == pytest.approx(0.75)
    assert area(np.zeros(4), right) == 0.5
