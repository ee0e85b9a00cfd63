"""The weights that are shipped are those of the published ledger, and so are the docs' figures."""

import hashlib
from pathlib import Path

import pytest
import yaml

from buggy_rl.diagnosis.search import posterior
from buggy_rl.diagnosis.search.posterior import SHIPPED, shipped
from buggy_rl.proof.calibrate import calibration
from buggy_rl.proof.calibrate.calibration import calibrated, feature_table, left_out, weights
from buggy_rl.proof.calibrate.intervals import (
    form_error,
    intervals,
    scored_numbers,
)
from buggy_rl.proof.ledger import searched
from buggy_rl.proof.score.tables import best_single, by_pairing, counted, lowest_loss

DOCS = Path(__file__).parents[2] / "docs"
NAMES = ("cases", "fresh", "enlarged", "opened", "opened_03c9054")
LEDGERS = [DOCS / "development" / f"{name}.jsonl.gz" for name in NAMES]

slow = pytest.mark.slow  # features of over a thousand cases, and fits to them


@pytest.fixture(scope="module")
def cases():
    """Searched cases of all ledgers; features of a case are computed once for all tests here."""
    found = searched(LEDGERS)
    kept = {id(entry.seen): posterior.of_hypotheses(entry.seen) for entry in found}
    with pytest.MonkeyPatch.context() as patch:
        for module in (posterior, calibration):
            patch.setattr(module, "of_hypotheses", lambda seen: kept[id(seen)])
        yield found


@pytest.fixture(scope="module")
def later(cases):
    """Cases that have all features: what is counted."""
    return [entry for entry in cases if entry.seen.null.changed is not None]


@pytest.fixture(scope="module")
def made_from():
    return yaml.safe_load(SHIPPED.read_text())["made_from"]


@pytest.fixture(scope="module")
def text():
    return (DOCS / "evidence.md").read_text()


def test_the_file_names_the_ledger_it_was_made_from(made_from):
    hashes = {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in LEDGERS}
    assert made_from["ledgers"] == hashes


@slow
def test_the_file_names_as_many_cases(cases, made_from):
    assert made_from["cases"] == len(cases)


def shipped_are(again):
    for part in ("hypothesis", "unknown"):
        new, kept = getattr(again, part), getattr(shipped(), part)
        assert list(new) == list(kept)
        for name, weight in new.items():
            assert weight == pytest.approx(kept[name], rel=1e-2, abs=1e-4)


@slow
def test_a_fit_at_the_ridge_of_the_file_makes_the_weights_again(cases, made_from):
    table = feature_table(cases)
    fitted = weights(table, made_from["ridge"])
    hypothesis, unknown = (
        dict(zip(names, values.tolist(), strict=True))
        for names, values in zip(table.names, fitted, strict=True)
    )
    shipped_are(posterior.Calibration(hypothesis, unknown))


@slow
def test_the_script_makes_the_weights_again(cases, made_from):
    again, ridge = calibrated(cases)
    assert ridge == made_from["ridge"]
    shipped_are(again)


@slow
def test_the_form_error_is_the_narrowest_that_covers(cases):
    assert form_error(scored_numbers(cases)) == shipped().form_error


@slow
def test_the_coverage_of_the_docs_is_that_of_the_ledger(later, text):
    for line in intervals(later).splitlines():
        assert line in text


def by_loss(cases):
    """What the held-out loss alone names: methods in whose columns nothing is fitted."""
    return {
        "lowest loss": [e.scored(lowest_loss(e)) for e in cases],
        "best single": [e.scored(best_single(e)) for e in cases],
    }


@slow
def test_the_columns_of_the_docs_that_need_no_weights_are_those_of_the_ledger(later, text):
    lines = text.splitlines()
    rows = counted(by_loss(later)).splitlines()[2:]
    assert len(rows) > 10
    for row in rows:
        _, name, columns = row.split("|", 2)
        name = f"|{name}|"
        assert [line for line in lines if line.startswith(name) and line.endswith(columns)]


@slow
def test_the_table_of_the_docs_is_that_of_the_ledger(cases, later, made_from, text):
    found, _ = left_out(cases, made_from["ridge"])
    said = {id(entry): answer for entry, answer in zip(cases, found, strict=True)}
    methods = {"posterior": [e.scored(said[id(e)]) for e in later], **by_loss(later)}
    pairings = by_pairing(methods["posterior"])
    for line in (*counted(methods).splitlines(), *pairings.splitlines()):
        assert line in text
