import math
from types import SimpleNamespace

import pytest
import torch

from buggy_rl.diagnosis.confidence import Doubts, confidences
from buggy_rl.diagnosis.confidence import soundness as soundness_of
from buggy_rl.diagnosis.config import DEFAULTS
from buggy_rl.diagnosis.constancy import Variation
from buggy_rl.diagnosis.search_result import SearchResult


def _candidate(effects, *excesses):
    """Leaves an excess over the noise in each of four segments, or the same one in all."""
    root = 1 + torch.tensor(excesses).expand(4)
    fit = SimpleNamespace(whitened=root.unsqueeze(-1).expand(4, 6), effects=effects)
    return SimpleNamespace(effects=effects, held_out=root.square(), fit=fit)


class Found(SearchResult):
    """A search result whose losses are plain."""

    def loss(self, candidate):
        return 100.0 * float(candidate.held_out.mean())


def _found(tried, best):
    return Found(tried[best], tried, None, 1.0)  # type: ignore[arg-type]


@pytest.fixture
def found():
    """Of an excess of 5, `large` closes most and `small` a half of the little that is left."""
    excesses = {(): 5.0, ("large",): 0.8, ("small",): 4.6, ("large", "small"): 0.4}
    tried = {effects: _candidate(effects, excess) for effects, excess in excesses.items()}
    return _found(tried, ("large", "small"))


def test_an_effect_closes_the_excess_that_comes_back_without_it(found):
    assert found.without("large") == pytest.approx(4.6)
    assert found.closed("large") == pytest.approx(4.2)
    assert found.closed("small") == pytest.approx(0.4)


def test_a_minor_effect_is_no_more_probable_for_closing_much_of_a_small_rest(found):
    closed = {effect: found.closed(effect) / 5.0 for effect in found.best.effects}
    doubts = Doubts(closed, 0.4 / 5.0, dict.fromkeys(closed, Variation()))
    sure = confidences(found, doubts, DEFAULTS)
    assert sure["large"].probability > 0.9
    assert sure["small"].probability < 0.5


NO_DOUBTS = Doubts({"a": 1.0}, 0.0, {"a": Variation()})


def _confidence(tried, doubts=NO_DOUBTS):
    return confidences(_found(tried, ("a",)), doubts, DEFAULTS)["a"]


def _among_two(own, its, first=5.0, varies=Variation()):  # noqa: B008  frozen
    """Confidence of an effect that leaves `own` of an excess where an alternative leaves `its`."""
    tried = {(): _candidate((), first), ("a",): _candidate(("a",), own)}
    tried["b",] = _candidate(("b",), its)
    return _confidence(tried, Doubts({"a": 1.0}, 0.0, {"a": varies}))


def test_an_alternative_that_leaves_little_more_than_the_best_is_listed():
    close = _among_two(0.2, 0.4)
    assert close.probability < 0.85
    assert set(close.alternatives) == {"b"}
    assert _among_two(0.2, 2.0).probability > 0.95


def test_an_alternative_is_ruled_out_that_leaves_much_more_or_a_large_share_of_the_excess():
    assert _among_two(0.0, 0.4).probability > 0.95
    assert _among_two(0.2, 0.4, first=1.0).probability > 0.95


def test_an_effect_whose_parameter_varies_is_improbable_and_names_the_condition():
    assert _among_two(0.2, 2.0).varies == ""
    varied = _among_two(0.2, 2.0, varies=Variation("vx", 0.5, 300.0))
    assert varied.probability < 0.1
    assert varied.varies == "vx"


def test_an_effect_whose_parameter_lies_at_a_bound_is_half_as_probable():
    tried = {(): _candidate((), 5.0), ("a",): _candidate(("a",), 0.2)}
    within, at_bound = (
        _confidence(tried, Doubts({"a": 1.0}, 0.0, {"a": Variation()}, at)).probability
        for at in ((), ("a",))
    )
    assert within > 0.95
    assert at_bound == pytest.approx(within / 2)


def test_an_alternative_is_ruled_out_by_the_segments_in_which_the_two_differ():
    # Of four segments one was driven to decide; the rest would be the same with both.
    tried = {(): _candidate((), 8.0), ("a",): _candidate(("a",), 0.5, 0.5, 0.5, 0.0)}
    tried["b",] = _candidate(("b",), 0.5, 0.5, 0.5, 0.8)
    assert _confidence(tried).probability > 0.95
    tried["b",] = _candidate(("b",), 0.55, 0.55, 0.55, 0.0)
    assert set(_confidence(tried).alternatives) == {"b"}


def test_nats_between_alternatives_count_a_quarter():
    # 100 (1.22^2 - 1.2^2) = 4.84 nats to b and 100 (1.25^2 - 1.2^2) = 12.25 to none. The odds of
    # what they leave are larger: 25 times the shares 0.02 / 0.25 and 0.05 / 0.25, 2 and 5 nats.
    tried = {(): _candidate((), 0.25), ("a",): _candidate(("a",), 0.2)}
    tried["b",] = _candidate(("b",), 0.22)
    odds_b, odds_none = math.exp(-4.84 / 4), math.exp(-12.25 / 4)
    total = 1 + odds_b + odds_none
    found = _confidence(tried)
    assert found.probability == pytest.approx(1 / total, rel=1e-3)
    assert found.alternatives == {"b": pytest.approx(odds_b / total, rel=1e-3)}


def test_segments_weigh_by_the_mean_square_over_channels_in_which_two_hypotheses_differ():
    # 6^2 and 4^2 noise variances apart in two of four segments, so that these weigh 36 to 16:
    # b leaves 0.2 + 0.04 36 / 52 there, which is 25 0.0277 / 0.25 = 2.77 nats; none 25 0.05 / 0.25.
    def leaving(effects, apart, *excess):
        candidate = _candidate(effects, *excess)
        candidate.fit.whitened = torch.tensor(apart).expand(4).unsqueeze(-1).expand(4, 6)
        return candidate

    class Sharp(Found):
        def loss(self, candidate):
            return 100 * super().loss(candidate)  # so that nats do not bound what is left

    tried = {(): leaving((), 0.0, 0.25), ("a",): leaving(("a",), 0.0, 0.2)}
    tried["b",] = leaving(("b",), [6.0, 4.0, 0.0, 0.0], 0.24, 0.2, 0.2, 0.2)
    best = Sharp(tried["a",], tried, None, 1.0)  # type: ignore[arg-type]
    odds = math.exp(-25 * 0.04 * 36 / 52 / 0.25)
    total = 1 + odds + math.exp(-5.0)
    assert confidences(best, NO_DOUBTS, DEFAULTS)["a"].probability == pytest.approx(1 / total, 1e-3)


def test_no_effect_is_more_probable_than_99_percent():
    tried = {(): _candidate((), 50.0), ("a",): _candidate(("a",), 0.0)}
    assert _confidence(tried).probability == pytest.approx(0.99)


EVEN = DEFAULTS.even_ratio


def soundness(closed, remains):
    return soundness_of(closed, remains, DEFAULTS)


def test_an_effect_that_leaves_nothing_is_sound():
    assert soundness(0.9, 0.0) == 1.0


def test_an_effect_is_as_likely_right_as_not_where_it_closes_little_more_than_it_leaves():
    assert soundness(EVEN * 0.4, 0.4) == pytest.approx(0.5)
    # r = 2 EVEN: 4 / (4 + 1).
    assert soundness(2 * EVEN * 0.3, 0.3) == pytest.approx(0.8)


def test_an_effect_that_closes_nothing_is_not_sound():
    assert soundness(0.0, 0.5) == 0.0
    assert soundness(0.0, 0.0) == 0.0
