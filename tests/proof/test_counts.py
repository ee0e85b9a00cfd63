"""Counts over development cases, and that those of the docs are those of the ledger."""

from pathlib import Path

from buggy_rl.proof.calibrate.development import entries
from buggy_rl.proof.calibrate.discrimination import discrimination
from buggy_rl.proof.calibrate.named import fitted_counts
from tests.diagnosis import observations

DOCS = Path(__file__).parents[2] / "docs"


def entry(concealed, sets, simulator="reference", asked=()):
    """A case in which these sets of effects were fitted, some since they were asked for."""
    hypotheses = [observations.hypothesis(s, [1.0], 0.5, asked=s in asked) for s in sets]
    case = {"concealed": concealed, "plant": "reference", "simulator": simulator}
    return observations.case(hypotheses).to_dict() | {"case": case}


def test_what_is_counted():
    table = fitted_counts(
        [
            entry({}, [()]),
            entry({"payload": {}}, [(), ("payload",)]),
            entry({"payload": {}}, [(), ("payload",)], asked=[("payload",)]),
            entry({"payload": {}}, [(), ("gyro_bias",)], "learned"),
            entry({"payload": {}, "gyro_bias": {}}, [(), ("gyro_bias", "payload")], "learned"),
            entry({"yaw.time.linear.none": {}}, [()]),  # no effect: not counted
            {**entry({"payload": {}}, []), "hypotheses": []},  # it failed
        ]
    )
    assert "| one | 2 | 1 | 1 | 0 |" in table
    assert "| two | 0 | 0 | 1 | 1 |" in table
    assert "| three | 0 | 0 | 0 | 0 |" in table


def test_the_figures_of_the_docs_are_those_of_the_ledger():
    text = (DOCS / "evidence.md").read_text()
    ledgers = [DOCS / "development" / f"{name}.jsonl.gz" for name in ("cases", "fresh")]
    found = [e for file in ledgers for e in entries(file)]
    assert f"{len(found)} cases" in text
    for line in fitted_counts(found).splitlines()[2:]:
        assert line in text
    words = " ".join(text.split())
    for line in discrimination(found).splitlines()[1:]:
        _, _, figure = line.partition(": ")
        assert figure in words
