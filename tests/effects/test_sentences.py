"""What a person reads of each effect: words, numbers, units and the side."""

from pathlib import Path

import pytest
import yaml

from buggy_rl.effects import EFFECTS, effect_class

SENTENCES = yaml.safe_load(Path(__file__).with_name("sentences.yaml").read_text())


@pytest.mark.parametrize("row", SENTENCES, ids=lambda row: row["said"][:40])
def test_an_effect_says_what_it_does(row):
    assert effect_class(row["effect"]).sentence(row["values"]) == row["said"]


def test_every_effect_is_among_them():
    assert {row["effect"] for row in SENTENCES} == set(EFFECTS)
