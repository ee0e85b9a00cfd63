"""The weights that are shipped are those of the published ledger, and so are the docs' figures."""

import hashlib
from pathlib import Path

import pytest
import yaml

from buggy_rl.diagnosis.search.posterior import SHIPPED, load_calibration, shipped
from buggy_rl.proof.calibrate.calibration import calibrated, left_out
from buggy_rl.proof.calibrate.intervals import covered, form_error, intervals, scored_numbers
from buggy_rl.proof.ledger import searched
from buggy_rl.proof.score.tables import best_single, by_pairing, counted, lowest_loss, mcnemar

DOCS = Path(__file__).parents[2] / "docs"
LEDGERS = [DOCS / "development" / f"{name}.jsonl.gz" for name in ("cases", "fresh")]


@pytest.fixture(scope="module")
def cases():
    return searched(LEDGERS)


@pytest.fixture(scope="module")
def made_from():
    return yaml.safe_load(SHIPPED.read_text())["made_from"]


def test_the_file_names_the_ledger_it_was_made_from(cases, made_from):
    hashes = {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in LEDGERS}
    assert made_from["ledgers"] == hashes
    assert made_from["cases"] == len(cases)


def test_the_script_makes_the_weights_again(cases, made_from):
    again, ridge = calibrated(cases)
    assert ridge == made_from["ridge"]
    for part in ("hypothesis", "unknown"):
        new, kept = getattr(again, part), getattr(shipped(), part)
        assert list(new) == list(kept)
        for name, weight in new.items():
            assert weight == pytest.approx(kept[name], rel=1e-2, abs=1e-4)


def test_the_form_error_is_the_narrowest_that_covers(cases):
    assert form_error(scored_numbers(cases)) == shipped().form_error


def test_the_coverage_of_the_docs_is_that_of_the_ledger(cases):
    text = (DOCS / "evidence.md").read_text()
    for line in intervals(cases).splitlines():
        assert line in text


def test_a_form_error_of_the_earlier_cases_covers_the_fresh_ones():
    earlier, fresh = (searched([file]) for file in LEDGERS)
    form = form_error(scored_numbers(earlier))
    assert intervals(fresh, form).splitlines()[2] in (DOCS / "evidence.md").read_text()
    inside, _ = covered([(n, form) for n in scored_numbers(fresh)])
    assert 0.92 <= inside.value <= 0.97


def test_the_table_of_the_docs_is_that_of_the_ledger(cases, made_from):
    text = (DOCS / "evidence.md").read_text()
    found, _ = left_out(cases, made_from["ridge"])
    methods = {
        "posterior": [e.scored(p) for e, p in zip(cases, found, strict=True)],
        "lowest loss": [e.scored(lowest_loss(e)) for e in cases],
        "best single": [e.scored(best_single(e)) for e in cases],
    }
    pairings = by_pairing(methods["posterior"])
    for line in (*counted(methods).splitlines(), *pairings.splitlines()):
        assert line in text


def test_the_fresh_cases_of_the_docs_are_answered_by_earlier_weights():
    text = (DOCS / "evidence.md").read_text()
    fresh = searched(LEDGERS[1:])
    earlier = load_calibration(DOCS / "development" / "weights_418.yaml")
    assert earlier.cases < shipped().cases
    found = [e.scored(e.posterior(earlier)) for e in fresh]
    for line in (
        *by_pairing(found).splitlines(),
        *intervals(fresh, earlier.form_error).splitlines(),
        mcnemar(found, [e.scored(best_single(e)) for e in fresh], "best single"),
    ):
        assert line in text
    rows = counted({"posterior": found}).splitlines()[2:]
    for row in rows:
        assert row.rstrip("|") in text
