"""Gradient boosting beside the posterior: the alternatives that it sees, and that it learns."""

import numpy as np
from benchmarks.ranking import boosted, features

from tests.proof.test_calibration import drawn


def test_features_of_a_case_are_those_of_all_its_alternatives():
    seen = features(np.arange(12.0).reshape(1, 3, 4), np.array([[7.0, 8.0]]))
    assert seen.shape == (1, 4, 6)
    assert (seen[..., 4:] == [7.0, 8.0]).all()
    assert np.isnan(seen[0, 3, :4]).all()
    assert seen[0, 1, :4].tolist() == [4.0, 5.0, 6.0, 7.0]


def test_trees_name_what_is_missing_in_cases_that_they_were_not_grown_on():
    chance = np.random.default_rng(0)
    cases = [drawn(seed, chance) for seed in range(120)]
    found = boosted(cases)
    assert all(abs(sum(p.sets.values()) + p.unknown - 1) < 1e-9 for p in found)
    assert np.mean([e.scored(p).all_right for e, p in zip(cases, found, strict=True)]) > 0.9
