"""Opened cases of a proof's run as development cases: which they are, and in which order."""

from dataclasses import replace

import pytest

from buggy_rl.diagnosis.search.posterior import Posterior
from buggy_rl.proof.calibrate.calibration import group
from buggy_rl.proof.calibrate.development import DevelopmentConfig, opened_cases
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.sealing import CaseStore, publish, sealed_text
from buggy_rl.proof.ledger import Entry, Ledger
from buggy_rl.proof.real.case import RealCase
from buggy_rl.proof.score.tables import by_pairing
from tests.diagnosis.observations import case, hypothesis

SYNTHETIC = [
    Case(7, "reference", "mujoco"),
    Case(8, "reference", "reference", concealed={"wind": {"force_x": 1.0, "force_y": 0.0}}),
]
EDITED = [
    RealCase(3, "dart", "2a", "single_track", True, {"gyro_bias": {"bias": 0.1}}),
    RealCase(4, "dart", "2b", "learned", False, {}),
]
SEEN = case([hypothesis((), [1.0, 2.0], 0.1)])


def sealed(folder, cases):
    store = CaseStore(folder, folder / "sealed")
    store.sealed.mkdir(parents=True)
    publish(store, cases, "secret")
    for one in cases:
        store.truth(one.id).write_text(sealed_text(one, "secret"))
    return store


@pytest.mark.parametrize("cases", [SYNTHETIC, EDITED])
def test_all_are_open_where_a_run_has_no_ledger(tmp_path, cases):
    assert opened_cases(sealed(tmp_path / "run", cases)) == cases


def test_only_those_in_the_ledger_are_open_where_there_is_one(tmp_path):
    store = sealed(tmp_path / "run", SYNTHETIC)
    ledger = Ledger(store.output / "ledger.jsonl")
    entry = Entry(SYNTHETIC[1].id, "third", SYNTHETIC[1], evidence=SEEN)
    ledger.enter([entry])
    assert opened_cases(store) == SYNTHETIC[1:]
    ledger.replace([replace(entry, opened=None, seal="0" * 64)])
    with pytest.raises(ValueError, match="is sealed"):
        opened_cases(store)


def test_slow_ones_come_last_and_none_twice(tmp_path):
    sealed(tmp_path / "run", SYNTHETIC)
    config = DevelopmentConfig(
        output=str(tmp_path), opened={str(tmp_path / "run"): str(tmp_path / "run" / "sealed")}
    )
    [left] = config.left_opened.values()
    assert left == SYNTHETIC[::-1]
    config.lines.enter([Entry(left[0].id, opened=left[0], evidence=SEEN)])
    assert [*config.left_opened.values()] == [left[1:]]


def test_edited_recordings_are_lines_groups_and_rows_as_others_are():
    entries = [Entry(c.id, "development_real", c, evidence=SEEN) for c in EDITED]
    again = [Entry.from_dict(entry.to_dict()) for entry in entries]
    assert [entry.case for entry in again] == EDITED
    assert len({group(entry.case) for entry in again}) == 2
    table = by_pairing([entry.scored(Posterior({(): 1.0}, 0.0)) for entry in again])
    assert "| dart -> single_track, baseline | 0 of 1 |" in table
    assert "| dart -> learned |" in table
