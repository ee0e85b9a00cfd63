"""A stranger checks what was published: each thing that could be changed afterwards is found."""

from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from buggy_rl.proof.cases.draw import DrawConfig, drawn
from buggy_rl.proof.cases.sealing import CaseStore, publish
from buggy_rl.proof.cases.secret import publish_secret, secret_of
from buggy_rl.proof.checking import checked, published
from buggy_rl.proof.ledger import Entry, Ledger
from tests.running import run_script

DRAW = {"cases": 3, "pairings": ["reference"], "split": "sealed"}
MADE = {"commit": "abcdef012", "source": "1", "time": "2026-11-28T10:00:00+00:00"}


@pytest.fixture
def folder(tmp_path):
    """A run of three cases, as it is published."""
    store = CaseStore(tmp_path / "run", tmp_path / "sealed")
    for place in (store.output, store.sealed):
        place.mkdir()
    secret = secret_of(store)
    cases = drawn(DrawConfig(**DRAW), secret)
    publish(store, cases, secret)
    made = {**MADE, "confined": "landlock"}
    ledger = Ledger(store.output / "ledger.jsonl")
    ledger.enter(Entry(case.id, "sealed", case, failed="it spins", made=made) for case in cases)
    publish_secret(store)
    return store.output


def test_what_holds_is_said(folder):
    found = published(folder)
    lines = checked(found, drawn(DrawConfig(**DRAW), found.secret))
    assert "3 cases: what was concealed has the published hash" in lines[1]
    assert lines[2] == "3 cases are what the secret draws: nobody chose them"
    assert lines[-1] == "3 of 3 diagnoses could not read what was sealed"


def test_another_secret_is_found(folder):
    (folder / "secret.txt").write_text("another\n")
    with pytest.raises(ValueError, match="is not the secret"):
        published(folder)


def test_before_the_secret_is_published_it_is_said(folder):
    (folder / "secret.txt").unlink()
    with pytest.raises(FileNotFoundError, match="published when all cases were counted"):
        published(folder)


def test_a_truth_that_was_changed_afterwards_is_found(folder):
    ledger = Ledger(folder / "ledger.jsonl")
    entry = ledger.entries()[1]
    ledger.replace([replace(entry, opened=replace(entry.case, concealed={}, seconds=99.0))])
    with pytest.raises(ValueError, match=f"case {entry.id}: .* has another hash"):
        checked(published(folder))


def test_a_case_that_was_left_out_is_found(folder):
    lines = (folder / "ledger.jsonl").read_text().splitlines(keepends=True)
    (folder / "ledger.jsonl").write_text("".join(lines[:2]))
    with pytest.raises(ValueError, match="is not in the ledger, or not opened there; 1 of 3"):
        checked(published(folder))


def test_a_count_ends_where_it_was_said_to(folder):
    found = published(folder)
    ids = [entry.id for entry in found.entries]
    counted = replace(found, entries=found.entries[:2])
    lines = checked(counted, drawn(DrawConfig(**DRAW), found.secret), last=ids[1])
    assert "2 cases: what was concealed has the published hash, and none is left out" in lines[1]
    assert lines[2] == f"1 that were sealed come after {ids[1]} and were never opened"
    with pytest.raises(ValueError, match=f"case {ids[2]} .* not opened there; 1 of 3"):
        checked(counted, last=ids[2])
    with pytest.raises(ValueError, match="no such case was sealed"):
        checked(counted, last="7")


def test_cases_that_the_secret_does_not_draw_are_found(folder):
    found = published(folder)
    others = drawn(DrawConfig(**DRAW), "another secret")
    with pytest.raises(ValueError, match="is not what the secret draws"):
        checked(found, others)


def test_a_case_that_was_drawn_and_never_sealed_is_found(folder):
    found = published(folder)
    more = drawn(DrawConfig(**{**DRAW, "cases": 4}), found.secret)
    with pytest.raises(ValueError, match="was drawn, not sealed; 1 were not"):
        checked(found, more)


def test_the_command_draws_them_again(folder, tmp_path: Path):
    file = tmp_path / "proof.yaml"
    file.write_text(yaml.safe_dump({"output": "runs/x", "draw": DRAW}))
    said = run_script("scripts/check_proof.py", f"folder={folder}", f"config={file}")
    assert "nobody chose them" in said.stdout


def test_an_error_that_is_published_does_not_say_where_the_run_was(tmp_path):
    store = CaseStore(tmp_path / "run", tmp_path / "sealed")
    error = ValueError(f"{store.inputs('7') / 'drive_0.csv'}, row 3: it leaps")
    assert store.told(error) == "ValueError: cases/7/drive_0.csv, row 3: it leaps"
    aside = ValueError(f"{store.held_out('7') / 'drive_2.csv'}, row 3: it leaps")
    assert store.told(aside) == "ValueError: 7/drive_2.csv, row 3: it leaps"
