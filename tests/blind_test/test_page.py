"""The page: every figure with its target, every failing case with the truth."""

from collections import Counter

import pytest

from buggy_rl.blind_test.case import Case
from buggy_rl.blind_test.opening import open_once, openings
from buggy_rl.blind_test.outcome import Outcome, Said
from buggy_rl.blind_test.page import failing, figures, write_page
from buggy_rl.blind_test.proof import ProofConfig
from buggy_rl.blind_test.score import score

WIND = {"wind": {"force_x": 0.2, "force_y": -0.3}}
NUMBERS = {"rate": {"value": 0.123, "low": 0.1, "high": 0.2}}


@pytest.fixture(scope="module")
def scores():
    right = Outcome(
        Case(1, "reference", "reference", concealed=WIND),
        "answered",
        "missing_physics",
        (Said("wind", 0.9),),
        margin=40.0,
    )
    wrong = Outcome(
        Case(2, "reference", "reference", concealed=WIND, nuisance="jitter"),
        "answered",
        "missing_physics",
        (Said("viscous_drag", 0.8, NUMBERS),),
        margin=12.0,
    )
    none = Outcome(Case(3, "reference", "reference"), "answered", "no_mismatch")
    return {"ours": score([right, wrong, none]), "guessing": score([wrong, none])}


def test_the_table_has_targets_figures_and_who_else_answered(scores):
    lines = figures(scores).splitlines()
    assert lines[0] == "| figure | target | measured | n | guessing |"
    first = next(line for line in lines if line.startswith("| first name right, decidable"))
    # 1 of 2: Wilson's interval of a half is 9.5 to 90.5 %; what misses its target stands out.
    assert "| at least 90 % | **50.0 % (9.5 to 90.5)** | 2 | 0.0 % (0.0 to 79.3) |" in first


def test_failing_cases_tell_what_was_said_and_what_was_true(scores):
    text = failing(scores["ours"].failing)
    assert text.splitlines()[2:] == [
        "| 0000002 | reference -> reference | jitter | 2 x 45 s rich | "
        "wind force_x 0.2, force_y -0.3 | missing physics: viscous_drag rate 0.123 (0.80) "
        "| 12 nats | wind is not named; viscous_drag is not there |"
    ]
    assert failing([]) == "None."


def test_the_page_says_how_it_is_made_and_shows_its_pictures(scores, tmp_path):
    config = ProofConfig(output=str(tmp_path / "out"), page=str(tmp_path / "docs" / "proof.md"),
                         images=str(tmp_path / "docs" / "images"))  # fmt: skip
    file = write_page(config, scores, "python scripts/prove.py configs/proof.yaml", 0)
    text = file.read_text()
    assert "```sh\npython scripts/prove.py configs/proof.yaml\n```" in text
    assert "development seeds" in text
    for kind in ("figures", "classes", "confidence", "confusion"):
        assert f"](images/proof_{kind}.png)" in text
        picture = tmp_path / "docs" / "images" / f"proof_{kind}.png"
        assert picture.read_bytes().startswith(b"\x89PNG")


def test_openings_are_counted(tmp_path):
    file = tmp_path / "opened.json"
    assert openings(file) == 0
    assert [open_once(file), open_once(file), openings(file)] == [1, 2, 2]


def test_what_was_said_of_each_effect_adds_up(scores):
    assert scores["ours"].confusion == {
        "nothing": Counter({"no_mismatch": 1}),
        "wind": Counter({"wind": 1, "viscous_drag": 1}),
    }
