"""Tables over cases that were searched, and that those of the docs are those of the ledgers."""

from pathlib import Path

import pytest

from buggy_rl.diagnosis.search.posterior import Posterior
from buggy_rl.proof.calibrate.discrimination import discrimination
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.ledger import Entry, Ledger
from buggy_rl.proof.plants.composed import SORTS
from buggy_rl.proof.score.tables import by_pairing, fitted_counts, mcnemar
from tests.diagnosis import observations
from tests.diagnosis.observations import hypothesis
from tests.proof.test_calibration import entry

DOCS = Path(__file__).parents[2] / "docs"
HYPOTHESES = [hypothesis(e, [10.0, 10.0], 0.5) for e in ((), ("payload",), ("wind",))]
SURE = Posterior({(): 0.1, ("payload",): 0.9}, 0.0)
UNSURE = Posterior({(): 0.1, ("payload",): 0.3}, 0.6)


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
    o = entry(0, concealed, HYPOTHESES).scored(Posterior(sets, unknown))
    assert o.all_right == expected


def test_cases_that_one_method_alone_has_right_are_counted_and_tested():
    wrong = Posterior({(): 0.1, ("wind",): 0.9}, 0.0)
    ours, theirs = (
        [entry(seed, ["payload"], HYPOTHESES).scored(said) for seed, said in enumerate(answers)]
        for answers in ([SURE, SURE, wrong], [SURE, wrong, SURE])
    )
    text = mcnemar(ours, theirs, "another")
    assert "2 by the posterior, 2 by another; only one of both 1 : 1" in text
    assert text.endswith("p = 1)")


def test_each_pairing_has_a_row_with_what_is_right_of_how_many():
    scored = [
        entry(0, ["payload"], HYPOTHESES).scored(SURE),  # seeds 0 and 3 are of one plant
        entry(3, ["wind"], HYPOTHESES).scored(SURE),
        entry(1, [SORTS[0]], HYPOTHESES).scored(UNSURE),
        entry(4, [SORTS[0]], HYPOTHESES).scored(SURE),
        entry(2, [], HYPOTHESES).scored(SURE),
    ]
    assert by_pairing(scored).splitlines()[2:] == [
        "| commonroad -> reference, baseline |  |  |  | 0 of 1 | 1 of 1 |",
        "| mujoco -> reference, baseline |  |  | 1 of 2 |  | 1 of 2 |",
        "| reference -> reference, baseline | 1 of 2 |  |  |  |  |",
    ]


def fitted(concealed, sets, simulator="reference", asked=(), **options):
    """A case in which these sets of effects were fitted, some since they were asked for."""
    case = Case(1, "reference", simulator, concealed=concealed, **options)
    hypotheses = [hypothesis(s, [1.0], 0.5, asked=s in asked) for s in sets]
    seen = observations.case(hypotheses) if sets else None
    return Entry(case.id, opened=case, evidence=seen, failed="" if sets else "it spins")


def test_sets_that_the_search_came_to_are_counted():
    table = fitted_counts(
        [
            fitted({}, [()]),
            fitted({"payload": {}}, [(), ("payload",)]),
            fitted({"payload": {}}, [(), ("payload",)], asked=[("payload",)]),
            fitted({"payload": {}}, [(), ("gyro_bias",)], "learned"),
            fitted({"payload": {}, "gyro_bias": {}}, [(), ("gyro_bias", "payload")], "learned"),
            fitted({SORTS[0]: {}}, [()]),  # no effect: not counted
            fitted({"drag_brake": {}}, [()]),  # nor this, of a car with a throttle
            fitted({"payload": {}}, []),
        ]
    )
    assert "| one | 2 | 1 | 1 | 0 |" in table
    assert "| two | 0 | 0 | 1 | 1 |" in table
    assert "| three | 0 | 0 | 0 | 0 |" in table


def test_a_drag_brake_is_an_effect_of_a_car_whose_command_has_one():
    braked = fitted({"drag_brake": {}}, [(), ("drag_brake",)], command="brakes")
    assert not braked.case.unknown
    assert "| one | 1 | 1 | 0 | 0 |" in fitted_counts([braked])


def test_the_figures_of_the_docs_are_those_of_the_ledger():
    text = (DOCS / "evidence.md").read_text()
    files = sorted((DOCS / "development").glob("opened*.jsonl.gz"))
    found = [entry for file in files for entry in Ledger(file).entries()]
    assert f"{len(found)} cases" in text
    for line in fitted_counts(found).splitlines()[2:]:
        assert line in text
    words = " ".join(text.split())
    for line in discrimination(found).splitlines()[1:]:
        _, _, figure = line.partition(": ")
        assert figure in words
