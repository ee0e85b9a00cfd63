"""Which of two methods is exactly right more often."""

import pytest

from buggy_rl.diagnosis.search.posterior import Posterior
from buggy_rl.proof.calibrate.named import mcnemar, right
from buggy_rl.proof.plants.composed import SORTS
from tests.diagnosis.observations import hypothesis
from tests.proof.test_calibration import entry

HYPOTHESES = [hypothesis(e, [10.0, 10.0], 0.5) for e in ((), ("payload",), ("wind",))]


@pytest.mark.parametrize(
    ("concealed", "sets", "unknown", "expected"),
    [
        (["payload"], {("payload",): 0.9, (): 0.1}, 0.0, True),
        (["payload"], {("payload", "wind"): 0.9, (): 0.1}, 0.0, False),
        (["payload"], {("payload",): 0.1}, 0.9, False),
        ([], {(): 1.0}, 0.0, True),
        ([], {("wind",): 0.9, (): 0.1}, 0.0, False),
        ([SORTS[0]], {(): 0.1}, 0.9, True),
        ([SORTS[0]], {(): 1.0}, 0.0, False),
    ],
)
def test_an_answer_is_right_that_says_exactly_what_is_missing(concealed, sets, unknown, expected):
    assert right(entry(0, concealed, HYPOTHESES), Posterior(sets, unknown)) == expected


def test_cases_that_one_method_alone_has_right_are_counted_and_tested():
    entries = [entry(seed, ["payload"], HYPOTHESES) for seed in range(3)]
    sure = Posterior({(): 0.1, ("payload",): 0.9}, 0.0)
    wrong = Posterior({(): 0.1, ("wind",): 0.9}, 0.0)
    text = mcnemar(entries, [sure, sure, wrong], [sure, wrong, sure], "another")
    assert "2 by the posterior, 2 by another; only one of both 1 : 1" in text
    assert text.endswith("p = 1)")
