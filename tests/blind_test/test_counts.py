"""Counts over development cases, and that those of the docs are those of the ledger."""

from pathlib import Path

from buggy_rl.blind_test.counts import counts, most_evident
from buggy_rl.blind_test.development import entries
from buggy_rl.blind_test.discrimination import discrimination

DOCS = Path(__file__).parents[2] / "docs"


def entry(concealed, rank, evident, simulator="reference"):
    """A case with the evidence of each set of effects."""
    hypotheses = [
        {"effects": list(effects), "evidence": {"log_evidence": value}}
        for effects, value in evident.items()
    ]
    case = {"concealed": concealed, "plant": "reference", "simulator": simulator}
    return {"case": case, "rank": rank, "hypotheses": hypotheses}


def test_an_effect_more_has_its_price():
    found = {(): -100.0, ("payload",): -50.0, ("gyro_bias", "payload"): -48.0}
    assert most_evident(entry({}, 0, found)) == ["payload"]
    assert most_evident(entry({}, 0, found | {(): -52.0})) == []
    assert most_evident(entry({}, 0, found | {("gyro_bias", "payload"): -40.0})) == [
        "gyro_bias",
        "payload",
    ]


def test_what_is_counted():
    right, wrong = {(): -90.0, ("payload",): -10.0}, {(): -1.0, ("payload",): -10.0}
    table = counts(
        [
            entry({}, 0, wrong),
            entry({}, 0, right, "learned"),
            entry({"payload": {}}, 1, right),
            entry({"payload": {}}, 7, right),  # beyond what is fitted, unless it is asked for
            entry({"payload": {}}, 1, wrong, "learned"),
            entry({"yaw.time.linear.none": {}}, 0, right),  # no effect: not counted
            {**entry({"payload": {}}, 0, {}), "hypotheses": []},  # it failed
        ]
    )
    assert "| nothing | 1 | - | 1 | 1 | - | 0 |" in table
    assert "| one | 2 | 1 | 2 | 1 | 1 | 0 |" in table
    assert "| two | 0 | 0 | 0 | 0 | 0 | 0 |" in table


def test_the_figures_of_the_docs_are_those_of_the_ledger():
    text = (DOCS / "evidence.md").read_text()
    found = entries(DOCS / "development" / "cases.jsonl")
    assert f"{len(found)} cases" in text
    for line in counts(found).splitlines()[2:]:
        assert line in text
    words = " ".join(text.split())
    for line in discrimination(found).splitlines()[1:]:
        _, _, figure = line.partition(": ")
        assert figure in words
