"""The whole proof, small: cars whose motion is known in the place of real ones.

Drives are short, the simulator is fitted for a moment, and the search is the least there is.
"""

import hashlib
import json
from pathlib import Path

import pytest
import yaml

from buggy_rl.proof.cases.sealing import CaseStore, publish
from buggy_rl.proof.cases.secret import publish_secret, secret_of
from buggy_rl.proof.checking import checked, drawn_again, published
from buggy_rl.proof.ledger import Entry, Ledger
from buggy_rl.proof.real.case import RealCase
from buggy_rl.proof.real.draw import RealDrawConfig, drawn
from tests.proof.here import jobs_here
from tests.running import Done, run_script

EFFECTS = "[steering_dead_time,steering_gain,sensor_yaw]"
OPTIONS = (
    "draw.cases=3", "draw.partitions=1", "draw.engines=[single_track]", "draw.least=12",
    "draw.families=[one,two]", "draw.edits=[steering_dead_time,sensor_yaw]",
    f"question.effects={EFFECTS}", "rivals=1", "draw.given=[false]",
)  # fmt: skip


def prove(folder: Path, config: Path, *more: str) -> Done:
    with jobs_here():
        return run_script("scripts/prove_real.py", str(config), f"output={folder}", *OPTIONS, *more)


@pytest.fixture(scope="module")
def proof(tmp_path_factory, drives) -> tuple[Path, Path, Done]:
    folder = tmp_path_factory.mktemp("real")
    data = {"recordings": [str(drives)], "car": "buggy"}
    data["fits"] = {
        "single_track": ["fit.iterations=1", "fit.windows=4", "fit.parameters=[steering_lag]"]
    }
    change = {"baseline": ["drive_0", "drive_1", "drive_3"], "after": ["drive_2"]}
    known = {"data": data, "fit": ["drive_1", "drive_3"], "changes": {"repeat": change}}
    config = folder / "small.yaml"
    config.write_text(yaml.safe_dump({"datasets": {"small": data}, "known": known}))
    return folder / "run", config, prove(folder / "run", config)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_every_case_is_sealed_asked_weighed_entered_and_shown(proof):
    folder, _, done = proof
    assert done.returncode == 0, done.stderr
    store = CaseStore(folder, Path(f"{folder}_sealed"), cases=RealCase)
    lines = [json.loads(line) for line in (folder / "ledger.jsonl").read_text().splitlines()]
    assert len(lines) == 3
    for line in lines:
        case = RealCase(**line["case"])
        assert store.sealed_case(case.id) == case
        assert {*line["made"]} == {"commit", "source", "time", "confined"}
        assert set(line["weighed"]["strength"]) == set(case.truth)
        assert set(line["weighed"]["changed"]) == set(case.truth)
    page = (folder / "proof_real.md").read_text()
    assert "| one edit: first name right and above one half |" in page
    assert "| repeat | nothing | nothing above one half |" in page


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_published_secret_draws_the_cases_again(proof, dataset):
    folder, _, _ = proof
    secret = (folder / "secret.txt").read_bytes()
    assert (folder / "secret.sha256").read_text().split()[0] == hashlib.sha256(secret).hexdigest()
    settings = RealDrawConfig(
        cases=3, partitions=1, engines=["single_track"], least=12.0, families=["one", "two"],
        edits=["steering_dead_time", "sensor_yaw"], given=[False],
    )  # fmt: skip
    again = drawn(settings, {"small": dataset}, secret.decode().strip())
    lines = [json.loads(line) for line in (folder / "ledger.jsonl").read_text().splitlines()]
    assert [case.concealed for case in again] == [line["case"]["concealed"] for line in lines]


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_what_is_done_is_not_done_again(proof):
    folder, config, _ = proof
    names = ("*.csv", "outcome.json", "*_single_track.yaml")
    before = {f: f.stat().st_mtime_ns for name in names for f in folder.rglob(name)}
    done = prove(folder, config)
    assert done.returncode == 0, done.stderr
    assert {f: f.stat().st_mtime_ns for f in before} == before
    assert json.loads((folder / "opened.json").read_text()) == {"opened": 2}


def test_a_stranger_draws_edited_recordings_again(tmp_path, drives, dataset):
    store = CaseStore(tmp_path / "run", tmp_path / "sealed", cases=RealCase)
    for place in (store.output, store.sealed):
        place.mkdir()
    draw = {"cases": 2, "partitions": 1, "least": 12.0}
    secret = secret_of(store)
    cases = drawn(RealDrawConfig(**draw), {"small": dataset}, secret)
    publish(store, cases, secret)
    entries = (Entry(case.id, "real", case, failed="it spins") for case in cases)
    Ledger(store.output / "ledger.jsonl").enter(entries)
    publish_secret(store)
    config = tmp_path / "real.yaml"
    data = {"recordings": [str(drives)], "car": "buggy"}
    config.write_text(yaml.safe_dump({"output": "x", "draw": draw, "datasets": {"small": data}}))
    found = published(store.output)
    assert "2 cases are what the secret draws" in checked(found, drawn_again(found, str(config)))[2]
