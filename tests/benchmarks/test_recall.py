"""Cases of benchmarks/recall.py: every effect of the generator, from faint to strong."""

from pathlib import Path

import pytest
from benchmarks.recall import (
    PLACE,
    STRENGTHS,
    RecallConfig,
    cases,
    column,
    strength,
    table,
    written,
)

from buggy_rl.effects import effect_class
from buggy_rl.proof.cases.sizes import COMMANDED_SIZES, SIZES
from buggy_rl.proof.ledger import Entry, Ledger
from buggy_rl.proof.markdown import table_marks

EVERY = cases()


def test_every_effect_is_a_case_at_each_strength_under_a_seed_of_its_own():
    assert len({case.seed for case in EVERY}) == len(EVERY)
    of = {name: [c for c in EVERY if c.truth == (name,)] for name in SIZES | COMMANDED_SIZES}
    for found in of.values():
        assert [strength(c) for c in found] == list(STRENGTHS)


def test_a_stronger_case_is_farther_from_neutral():
    for faint, _, strong in zip(*[iter(EVERY)] * 3, strict=True):
        [name] = faint.truth
        for p in effect_class(name).declared:
            if p.name in faint.concealed[name] and p.name not in ("x", "y", "time_constant"):
                near, far = (
                    abs(p.coordinate(case.concealed[name][p.name])) for case in (faint, strong)
                )
                assert far >= near


def failed(why):
    [case, *_] = [c for c in EVERY if c.truth == ("payload",)]
    return Entry(case.id, "recall", case, failed=why)


def test_only_what_is_asked_for_and_not_done_is_left(tmp_path):
    config = RecallConfig(names=["payload"], output=str(tmp_path / "none.jsonl"))
    assert [c.truth for c in config.left] == [("payload",)] * len(STRENGTHS)
    config.lines.enter([failed("ValueError: drive drive_0 only spins")])
    assert [strength(c) for c in config.left] == ["middle", "strong"]


def test_a_refused_case_is_told_in_the_table():
    entry = failed("ValueError: drive drive_0 only spins")
    assert "| `payload` | refused: drive drive_0 only spins |" in table([entry])
    assert "first name right: 0 of 1" in table([entry])


ROOT = Path(__file__).parents[2]
BEGIN, END = table_marks(PLACE)
ROWS = "| effect | named |\n|---|---|\n| `wind` | – |\n| `payload` | 1 of 1 |\n"
TABLE = f"before\n{BEGIN}{ROWS}{END}after\n"


def test_the_column_of_a_page_is_filled_in_by_effect():
    text = written(TABLE, {"wind": "2 of 3"})
    assert text.startswith("before\n")
    assert text.endswith(f"{END}after\n")
    assert "| `wind` | 2 of 3 |\n| `payload` | – |\n" in text
    assert written(text, {"wind": "2 of 3"}) == text


def test_a_page_without_the_marks_or_the_row_is_refused():
    with pytest.raises(ValueError, match="no lines <!-- recall: begin -->"):
        written("no table", {})
    with pytest.raises(ValueError, match="no row for top_speed"):
        written(TABLE, {"top_speed": "1 of 3"})


def test_a_refused_case_counts_as_not_named():
    assert column([failed("ValueError: spins")]) == {"payload": "0 of 1"}


def test_the_column_of_the_readme_is_that_of_the_ledger():
    lines = Ledger(ROOT / "docs" / "development" / "recall.jsonl.gz").entries()
    text = (ROOT / "README.md").read_text()
    assert written(text, column(lines)) == text
