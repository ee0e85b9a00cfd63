from types import SimpleNamespace

import pytest
import torch

from buggy_rl.diagnosis.confidence import confidences
from buggy_rl.diagnosis.constancy import Varying
from buggy_rl.diagnosis.search import Found, Search
from buggy_rl.estimation.misfit import Usual


def _candidate(causes, *excesses):
    """Leaves an excess over the noise in each of four stretches, or the same one in all."""
    root = 1 + torch.tensor(excesses).expand(4)
    white = SimpleNamespace(white=root.unsqueeze(-1).expand(4, 6))
    return SimpleNamespace(causes=causes, held_out=root.square(), fitted=white)


@pytest.fixture
def found():
    """Of a gap of 5, `large` closes most and `small` a half of the little that is left."""
    sizes = {(): 5.0, ("large",): 0.8, ("small",): 4.6, ("large", "small"): 0.4}
    tried = {causes: _candidate(causes, excess) for causes, excess in sizes.items()}
    return Found(tried[()], tried["large", "small"], tried)


def test_what_a_cause_closes_is_what_comes_back_without_it(found):
    assert found.without("large") == pytest.approx(4.6)
    assert found.closed("large") == pytest.approx(4.2)
    assert found.closed("small") == pytest.approx(0.4)


class _Search:
    def loss(self, candidate):
        return 100.0 * float(candidate.held_out.mean())


def test_a_small_second_cause_is_no_surer_for_closing_much_of_a_small_rest(found):
    closed = {cause: found.closed(cause) / 5.0 for cause in found.best.causes}
    sure = confidences(_Search(), found, closed, 0.4 / 5.0, dict.fromkeys(closed, Varying()))
    assert sure["large"].sure > 0.9
    assert sure["small"].sure < 0.5


def _rivalry(own, its, gap=5.0, changing=Varying()):  # noqa: B008  frozen
    """How sure a cause is that leaves `own` of a gap where a rival leaves `its`."""
    tried = {(): _candidate((), gap), ("a",): _candidate(("a",), own)}
    tried["b",] = _candidate(("b",), its)
    found = Found(tried[()], tried["a",], tried)
    return confidences(_Search(), found, {"a": 1.0}, 0.0, {"a": changing})["a"]


def test_a_rival_that_leaves_little_more_than_the_best_is_not_ruled_out():
    close = _rivalry(0.2, 0.4)
    assert close.sure < 0.85
    assert set(close.rivals) == {"b"}
    assert _rivalry(0.2, 2.0).sure > 0.95


def test_a_rival_is_ruled_out_that_leaves_much_more_or_a_part_of_the_gap_that_matters():
    assert _rivalry(0.0, 0.4).sure > 0.95
    assert _rivalry(0.2, 0.4, gap=1.0).sure > 0.95


def _left_of(sizes, usual=0.0):
    """What the search keeps of the longest explanation, by what each leaves of the gap."""
    search = Search.__new__(Search)
    search.tried = {causes: _candidate(causes, excess) for causes, excess in sizes.items()}
    search.null = search.tried[()]
    search.merit = SimpleNamespace(usual=Usual(usual))
    search.fit = lambda starts: []
    return search.weighty(search.tried[max(sizes, key=len)]).causes


def test_a_further_cause_that_closes_less_than_what_remains_is_left_out():
    sizes = {(): 5.0, ("large",): 1.0, ("small",): 4.6}
    assert _left_of(sizes | {("large", "small"): 0.6}) == ("large",)
    assert _left_of(sizes | {("large", "small"): 0.4}) == ("large", "small")


def test_what_is_usual_does_not_count_as_remaining():
    sizes = {(): 5.0, ("large",): 1.0, ("small",): 4.6, ("large", "small"): 0.6}
    assert _left_of(sizes, usual=0.3) == ("large", "small")


def test_the_first_cause_stays_however_much_remains():
    sizes = {(): 5.0, ("a",): 4.0, ("b",): 4.5, ("a", "b"): 3.8}
    assert _left_of(sizes) == ("a",)


def test_the_smallest_goes_first_and_the_others_are_looked_at_again_without_it():
    sizes = {(): 5.0, ("a",): 1.2, ("b",): 2.0, ("c",): 4.9, ("a", "b"): 0.5, ("a", "c"): 1.1,
             ("b", "c"): 1.9, ("a", "b", "c"): 0.4}  # fmt: skip
    assert _left_of(sizes) == ("a", "b")


def test_a_name_whose_number_changes_with_how_one_drives_is_not_sure_and_says_with_what():
    assert _rivalry(0.2, 2.0).varies == ""
    found = _rivalry(0.2, 2.0, changing=Varying("vx", 0.5, 300.0))
    assert found.sure < 0.1
    assert found.varies == "vx"


def test_a_name_whose_number_lies_at_the_end_of_its_range_is_not_sure():
    tried = {(): _candidate((), 5.0), ("a",): _candidate(("a",), 0.2)}
    found = Found(tried[()], tried["a",], tried)
    within, at_end = (
        confidences(_Search(), found, {"a": 1.0}, 0.0, {"a": Varying()}, at_end)["a"].sure
        for at_end in ((), ("a",))
    )
    assert within > 0.95
    assert at_end < 0.5


def test_a_rival_is_ruled_out_where_the_two_differ_however_much_else_was_driven():
    # Of four stretches one was driven to decide; the rest would be the same with both.
    tried = {(): _candidate((), 8.0), ("a",): _candidate(("a",), 0.5, 0.5, 0.5, 0.0)}
    tried["b",] = _candidate(("b",), 0.5, 0.5, 0.5, 0.8)
    found = Found(tried[()], tried["a",], tried)
    decided = confidences(_Search(), found, {"a": 1.0}, 0.0, {"a": Varying()})["a"]
    assert decided.sure > 0.95
    tried["b",] = _candidate(("b",), 0.55, 0.55, 0.55, 0.0)
    undecided = confidences(_Search(), found, {"a": 1.0}, 0.0, {"a": Varying()})["a"]
    assert set(undecided.rivals) == {"b"}
