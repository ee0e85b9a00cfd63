"""Two methods on the same cases."""

import json

import pytest

from buggy_rl.blind_test.compared import compared, right
from buggy_rl.blind_test.named import Claimed
from buggy_rl.diagnosis.posterior import Posterior
from buggy_rl.plants.composed import SORTS
from tests.blind_test.test_calibration import entry
from tests.diagnosis.observations import hypothesis

HYPOTHESES = [hypothesis(e, [10.0, 10.0], 0.5) for e in ((), ("payload",), ("wind",))]


@pytest.mark.parametrize(
    ("concealed", "verdict", "named", "expected"),
    [
        (["payload"], "missing_physics", {"payload": 0.9}, True),
        (["payload"], "missing_physics", {"payload": 0.9, "wind": 0.6}, False),
        (["payload"], "unknown_physics", {"payload": 0.9}, False),
        ([], "no_mismatch", {}, True),
        ([], "missing_physics", {"wind": 0.9}, False),
        ([SORTS[0]], "unknown_physics", {}, True),
        ([SORTS[0]], "no_mismatch", {}, False),
    ],
)
def test_an_answer_is_right_that_says_exactly_what_is_missing(concealed, verdict, named, expected):
    assert right(entry(0, concealed, HYPOTHESES), Claimed(verdict, named)) == expected


def test_cases_that_both_have_answered_are_counted_and_only_those(tmp_path):
    entries = [entry(seed, ["payload"], HYPOTHESES) for seed in range(4)]
    sure = Posterior({(): 0.1, ("payload",): 0.9}, 0.0)
    wrong = Posterior({(): 0.1, ("wind",): 0.9}, 0.0)
    lines = [
        {"seed": 0, "verdict": "missing_physics", "named": {"payload": 0.9}},
        {"seed": 1, "verdict": "missing_physics", "named": {"wind": 0.9}},
        {"seed": 2, "verdict": "missing_physics", "named": {"payload": 0.8}},
    ]
    file = tmp_path / "stepwise.jsonl"
    file.write_text("\n".join(map(json.dumps, lines)))
    text = compared(entries, [sure, sure, wrong, sure], file)
    assert text.startswith("3 cases")
    assert "2 by the posterior, 2 by stepwise; only one of both 1 : 1" in text
