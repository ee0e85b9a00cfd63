"""Sealing edited recordings: nothing of the answer is seen."""

import hashlib
import json
import re

import pytest
import torch
import yaml

from buggy_rl.core import keys
from buggy_rl.core.files import write_atomically
from buggy_rl.proof.cases.sealing import CaseStore, publish
from buggy_rl.proof.cases.secret import secret_of
from buggy_rl.proof.real.case import RealCase
from buggy_rl.proof.real.dataset import DatasetConfig
from buggy_rl.proof.real.edits import EDITS, edited
from buggy_rl.proof.real.known import KnownConfig
from buggy_rl.proof.real.preparing import simulator_file
from buggy_rl.proof.real.real import RealProofConfig
from buggy_rl.proof.real.sealing import (
    QuestionConfig,
    seal_edited,
    unsealed_groups,
    write_question,
)
from buggy_rl.recordings import load_recordings

CASES = [
    RealCase(3_000_000, "small", "0a", "single_track", True, {"sensor_yaw": {"angle": 0.0731}}),
    RealCase(3_000_001, "small", "1b", "single_track", False, {"throttle_gain": {"gain": 1.2143}}),
    RealCase(3_000_002, "small", "0b", "single_track", True),
]
SIMULATOR = {"engine": "single_track", "parameters": {"steering_lag": 0.05}, "_warnings": ["none"]}


def store(folder) -> CaseStore:
    made = CaseStore(folder / "open", folder / "safe", cases=RealCase)
    for place in (made.output, made.sealed, made.prepared):
        place.mkdir(parents=True)
    for case in CASES:
        file = simulator_file(made.prepared, "small", case.other, case.engine)
        write_atomically(file, yaml.safe_dump(SIMULATOR))
    return made


@pytest.fixture(scope="module")
def sealed(tmp_path_factory, config) -> CaseStore:
    made = store(tmp_path_factory.mktemp("sealed"))
    secret = secret_of(made)
    publish(made, CASES, secret)
    assert seal_edited(made, CASES, {"small": config}, secret, QuestionConfig()) == 3
    return made


def files(folder) -> set[str]:
    return {str(f.relative_to(folder)) for f in folder.rglob("*") if f.is_file()}


def test_a_case_has_a_question_a_simulator_and_recordings_under_numbers(sealed):
    own = {"question.yaml", "simulator.yaml", "columns.yaml"}
    recordings = {f"recordings/drive_0{n}.csv" for n in (0, 1)}
    assert files(sealed.inputs("3000001")) == own | recordings
    baseline = {f"baseline/drive_0{n}.csv" for n in (0, 1)}
    assert files(sealed.inputs("3000000")) == own | recordings | baseline


def test_what_may_be_seen_names_no_edit_no_number_and_no_dataset(sealed):
    told = {*EDITS, "small", "concealed", "salt", "sealed", "0a", "half"}
    for case in CASES:
        for name in files(sealed.inputs(case.id)):
            text = (sealed.inputs(case.id) / name).read_text()
            assert not {*re.findall(r"[a-z_0-9]+", text)} & told, name
        for values in case.concealed.values():
            question = (sealed.inputs(case.id) / "question.yaml").read_text()
            assert not any(f"{v:g}" in question for v in values.values())


def test_the_recordings_are_the_edited_half_and_the_baseline_is_untouched(sealed, dataset):
    for case in CASES:
        folder = sealed.inputs(case.id)
        found, refusals = load_recordings([str(folder / "recordings")], folder / "columns.yaml")
        assert not refusals
        wanted = [edited(recording, case.concealed) for recording in dataset.half(case.half)]
        for seen, made in zip(found, wanted, strict=True):
            assert made is not None
            for key in (keys.POSE, keys.VELOCITY, keys.ACTION):
                assert torch.equal(seen.data[key], made.data[key])
    folder = sealed.inputs(CASES[0].id)
    before, _ = load_recordings([str(folder / "baseline")], folder / "columns.yaml")
    for seen, own in zip(before, dataset.half("0b"), strict=True):
        assert torch.equal(seen.data[keys.POSE], own.data[keys.POSE])
        assert torch.equal(seen.data[keys.ACTION], own.data[keys.ACTION])


def test_the_simulator_is_that_of_the_other_half_without_its_report(sealed):
    given = yaml.safe_load((sealed.inputs(CASES[0].id) / "simulator.yaml").read_text())
    assert given == {"engine": "single_track", "parameters": {"steering_lag": 0.05}}


def test_hashes_are_those_of_the_sealed_cases(sealed):
    lines = dict(reversed(line.split()) for line in sealed.hashes.read_text().splitlines())
    for case in CASES:
        content = sealed.truth(case.id).read_bytes()
        assert hashlib.sha256(content).hexdigest() == lines[case.id]
    assert [sealed.sealed_case(case.id) for case in CASES] == CASES
    salts = [json.loads(sealed.truth(case.id).read_text())["salt"] for case in CASES]
    assert len(set(salts)) == 3


def test_a_case_that_was_sealed_is_not_sealed_again(sealed):
    assert unsealed_groups(sealed, CASES) == []
    more = RealCase(3_000_003, "small", "0a", "mujoco")
    assert unsealed_groups(sealed, [*CASES, more]) == [[more]]


def test_recordings_before_they_were_edited_are_hidden_from_a_diagnosis(tmp_path, config):
    known = KnownConfig(data=DatasetConfig(recordings=[str(tmp_path / "known")]))
    run = RealProofConfig(output=str(tmp_path / "run"), datasets={"small": config}, known=known)
    names = {str(path) for path in run.hidden}
    assert {*config.recordings, str(tmp_path / "known")} <= names
    assert {str(tmp_path / "run"), str(tmp_path / "run_sealed")} <= names


def test_a_recording_that_a_reader_would_cut_is_refused(tmp_path, dataset, config):
    leaping = edited(dataset.recordings[0], {})
    assert leaping is not None
    leaping.data[keys.VELOCITY][100:200, 0] = 20.0  # m/s: no car of ours
    file = tmp_path / "simulator.yaml"
    write_atomically(file, yaml.safe_dump(SIMULATOR))
    with pytest.raises(ValueError, match=r"rows are cut|is refused"):
        write_question(tmp_path / "case", [leaping], [], file, config, QuestionConfig())
