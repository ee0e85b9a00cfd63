"""What is published of a proof is enough for its page, and says who answered when."""

import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from buggy_rl.proof.cases.draw import DrawConfig
from buggy_rl.proof.ledger import Ledger, answered_by, of_last_code
from buggy_rl.proof.proof import ProofConfig
from buggy_rl.proof.running import all_opened
from tests.running import run_script

PUBLISHED = Path(__file__).parents[2] / "docs" / "proof"
LEDGER = PUBLISHED / "third" / "ledger.jsonl"


@pytest.fixture
def folder(tmp_path):
    """The ledger of the third sealed set, alone in a folder."""
    made = tmp_path / "third"
    made.mkdir()
    shutil.copy(LEDGER, made)
    return made


def test_a_ledger_is_enough_for_the_page(folder):
    done = run_script(
        "scripts/prove.py", "configs/proof_third.yaml", f"output={folder}", "stages=[page]"
    )
    assert done.returncode == 0, done.stderr
    page = (folder / "proof.md").read_text()
    count = len(of_last_code(Ledger(LEDGER).entries()))
    assert f"{count} of {count} diagnoses could not read what was sealed" in page
    assert "stages=[page]" in page  # the command makes it again
    assert {file.suffix for file in folder.iterdir()} == {".jsonl", ".md", ".png"}
    assert not (folder.parent / "third_sealed").exists()


def test_a_ledger_with_a_sealed_line_is_not(folder):
    config = ProofConfig(output=str(folder), draw=DrawConfig(split="third"))
    entries = all_opened(config)
    assert len(entries) == len(Ledger(LEDGER).entries()) > 0
    config.lines.replace([replace(entries[0], opened=None)])
    assert all_opened(config) == []


def test_lines_of_other_kinds_do_not_count(folder):
    assert all_opened(ProofConfig(output=str(folder))) == []


def test_what_was_opened_before_the_code_was_changed_is_not_counted():
    first, second, third = Ledger(LEDGER).entries()[:3]
    made = {"time": "2030-01-01T00:00:00+00:00", "source": "other"}
    later = replace(second, made={**second.made, **made})
    assert of_last_code([first, later, third]) == [later]
    assert of_last_code([first, third]) == [first, third]
    assert of_last_code([]) == []


def test_who_answered_is_said_of_all_lines(folder):
    entries = Ledger(LEDGER).entries()
    other = {**entries[0].made, "commit": "abcdef0123", "source": "other", "confined": "no"}
    lines = answered_by([*entries[:2], replace(entries[2], made=other)])
    assert "commits 33083e3, abcdef0, 2 states of the source" in lines[0]
    assert lines[1] == "2 of 3 diagnoses could not read what was sealed"
    assert answered_by([replace(entries[0], made={})]) == [
        "the ledger does not say when its cases were diagnosed"
    ]


def test_a_ledger_of_edited_recordings_is_enough_for_its_tables(tmp_path):
    folder, page = tmp_path / "real", tmp_path / "page.md"
    folder.mkdir()
    shutil.copy(PUBLISHED / "real" / "ledger.jsonl", folder)
    shutil.copy(PUBLISHED.parent / "proof.md", page)
    given = (f"output={folder}", "stages=[page]", f"pages=[{page}]")
    done = run_script("scripts/prove_real.py", "configs/proof_real.yaml", *given)
    assert done.returncode == 0, done.stderr
    assert page.read_text() == (PUBLISHED.parent / "proof.md").read_text()


def test_every_wrong_name_of_an_edited_recording_is_told():
    made = (PUBLISHED / "real/proof_real.md").read_text()
    table = made.split("\n## Every wrong name above one half\n")[1].split("\n## ")[0]
    told = (PUBLISHED.parent / "proof.md").read_text().split("\n- **Wrong**: ")[1].split("\n")[0]
    counted = re.findall(r"^\| (3\d{6}) ", table, re.MULTILINE)
    assert counted == re.findall(r"\b3\d{6}\b", told)


def test_no_published_file_names_a_place_of_the_machine_that_made_it():
    files = [f for f in PUBLISHED.rglob("*") if f.suffix in {".json", ".jsonl", ".md", ".txt"}]
    assert len(files) > 40
    named = [f.name for f in files if re.search(r"(?<![\w.)/:])/\w+/\w", f.read_text())]
    assert named == []


def test_wrong_names_are_told_by_cause_as_often_as_the_page_counts_them():
    page = (PUBLISHED / "third/proof.md").read_text()
    table = page.split("Every wrong name above one half:")[1].split("\n## ")[0]
    counted = re.findall(r"^\| (2\d{6}) ", table, re.MULTILINE)
    causes = (PUBLISHED / "third/failures.md").read_text().split("\n- ")
    told = [case for cause in causes[1:] for case in re.findall(r"\b2\d{6}\b", cause)]
    assert sorted({*told}) == sorted({*counted})
    front = (PUBLISHED.parent / "proof.md").read_text()
    sentence = front.split("<!-- third_misnamed: begin -->\n")[1].split("\n")[0]
    numbers = [int(n) for n in re.findall(r"\b\d+\b", sentence)]
    assert numbers[1] == len({*counted})
    assert numbers[2:] == [len({*re.findall(r"\b2\d{6}\b", cause)}) for cause in causes[1:]]
