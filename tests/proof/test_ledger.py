"""The ledger: entered once, read the same anywhere, and sealed until it is opened."""

import gzip
import json
import re
import shutil
from dataclasses import asdict, replace

import pytest

from buggy_rl.core.files import write_json
from buggy_rl.proof.baselines import METHODS
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.draw import DrawConfig
from buggy_rl.proof.cases.sealing import CaseStore, publish, seal
from buggy_rl.proof.ledger import OURS, Entry, Ledger, searched
from buggy_rl.proof.proof import ProofConfig, complete, settle
from buggy_rl.proof.running import asked, open_entry, open_once, opened, openings
from tests.diagnosis import observations

CASE = Case(31, "reference", "reference", concealed={"payload": {"mass_ratio": 1.3}}, seconds=1.3)
OTHER = Case(32, "reference", "reference", seconds=1.3)
ANSWER = {
    "verdict": "missing_physics",
    "effects": [
        {
            "name": "payload",
            "confidence": 0.9,
            "parameters": {
                "mass_ratio": {"value": 1.28, "low": 1.2, "high": 1.36, "unit": "ratio"}
            },
            "confused_with": [{"name": "throttle_gain", "confidence": 0.1}],
        }
    ],
}
WEIGHED = {
    "nats": 80.0,
    "rivals": {"throttle_gain": 40.0},
    "parameters": {"payload": {"mass_ratio": 1.29}},
    "held_out": {n: {"error": e, "position": e} for n, e in (("as_given", 3.0), ("oracle", 1.0))},
}
ALONE = [stage for stage in ProofConfig().stages if stage != "compare"]


def answered(store: CaseStore, case: Case) -> None:
    write_json(store.diagnosis(case.id) / "diagnosis.json", ANSWER)
    write_json(store.diagnosis(case.id) / "outcome.json", {"status": "answered", "seconds": 3.0})


@pytest.fixture(scope="module")
def sealed(tmp_path_factory):
    """A folder in which one case is sealed and answered, of which each test has a copy."""
    folder = tmp_path_factory.mktemp("sealed")
    store = CaseStore(folder / "open", folder / "safe")
    for part in (store.output, store.sealed):
        part.mkdir()
    publish(store, [CASE, OTHER])
    seal(store, [CASE], [])
    answered(store, CASE)
    return folder


@pytest.fixture
def config(sealed, tmp_path) -> ProofConfig:
    shutil.copytree(sealed, tmp_path, dirs_exist_ok=True)
    return ProofConfig(output=str(tmp_path / "open"), sealed=str(tmp_path / "safe"), stages=ALONE)


@pytest.fixture
def settled(config) -> ProofConfig:
    write_json(config.store.oracle(CASE.id), WEIGHED)
    assert settle(config, [CASE, OTHER]) == 1
    return config


def test_a_case_is_entered_when_nothing_is_left_to_do_and_once(config):
    store, ledger = config.store, config.lines
    compared = replace(config, stages=["compare"])
    assert not complete(store, CASE)
    assert settle(compared, [CASE, OTHER]) == 0
    assert ledger.left([CASE, OTHER]) == [CASE, OTHER]
    write_json(store.oracle(CASE.id), WEIGHED)
    assert settle(compared, [CASE]) == 0  # other methods have not answered
    answered(store, CASE)  # asked anew: what was weighed was another answer
    assert not store.weighed(CASE.id)
    assert settle(config, [CASE]) == 0
    write_json(store.oracle(CASE.id), WEIGHED)
    assert settle(config, [CASE]) == 1
    assert settle(config, [CASE]) == 0
    assert ledger.left([CASE, OTHER]) == [OTHER]


def test_where_other_methods_answer_none_is_settled_before_all_have(config):
    store = config.store
    write_json(store.oracle(CASE.id), WEIGHED)
    file = store.diagnosis(CASE.id) / "baselines.json"
    silent = {"verdict": "cannot_tell", "effects": [], "seconds": 1.0}
    write_json(file, {next(iter(METHODS)): silent})
    assert settle(config, [CASE]) == 0
    write_json(file, dict.fromkeys(METHODS, silent))
    assert settle(config, [CASE]) == 1
    [entry] = config.lines.entries()
    assert set(entry.answers) == {OURS, *METHODS}


def test_the_truth_is_not_in_a_line_before_it_is_opened(settled):
    [line] = settled.lines.file.read_text().splitlines()
    assert set(json.loads(line)) == {"kind", "id", "seal", "seconds", "answers"}
    assert not {"concealed", "salt", "nats", "weighed"} & {*re.findall(r"\w+", line)}
    [entry] = settled.lines.entries()
    assert entry.seal == settled.store.digests()[CASE.id]
    with pytest.raises(ValueError, match="case 0000031 is sealed"):
        entry.scored()
    [told] = opened(settled, [CASE, OTHER])
    assert (told.case, told.weighed) == (CASE, WEIGHED)
    assert settled.lines.entries() == [told]
    assert json.loads(settled.lines.file.read_text())["case"] == asdict(CASE)


def test_what_is_read_is_what_was_entered_without_the_case_at_hand(settled, tmp_path):
    [here] = opened(settled, [CASE, OTHER])
    elsewhere = replace(settled, output=str(tmp_path / "elsewhere"), sealed="",
                        ledger=str(settled.lines.file))  # fmt: skip
    assert opened(elsewhere, [CASE, OTHER]) == [here]
    own = here.scored()
    assert (own.right, own.margin) == (True, 40.0)
    assert own.answer.said[0].rivals == ("throttle_gain",)
    assert opened(settled, [OTHER]) == []


def test_a_case_is_opened_where_it_was_sealed_and_only_as_it_was_sealed(settled, tmp_path):
    [entry] = settled.lines.entries()
    with pytest.raises(FileNotFoundError, match="score case 0000031 where it was sealed"):
        open_entry(CaseStore(tmp_path / "elsewhere", tmp_path / "elsewhere_sealed"), entry)
    elsewhere = replace(settled, output=str(tmp_path / "elsewhere"), ledger=str(settled.lines.file))
    with pytest.raises(FileNotFoundError, match="score case 0000031 where it was sealed"):
        opened(elsewhere, [CASE])  # the truth is at hand, what the oracle found of it is not
    truth = settled.store.truth(CASE.id)
    truth.write_text(truth.read_text().replace("1.3", "1.4"))
    with pytest.raises(ValueError, match="not what was sealed"):
        opened(settled, [CASE])


def test_what_is_not_entered_yet_is_scored_too(config):
    [entry] = opened(config, [CASE, OTHER])
    assert entry.scored().right
    assert entry.scored().margin is None
    assert config.lines.entries() == []


def test_a_ledger_of_other_settings_is_refused(settled):
    other = Case(31, "reference", "reference", seconds=1.3)
    seals = {CASE.id: "another"}
    with pytest.raises(
        ValueError, match=r"ledger\.jsonl: case 0000031 was drawn by other settings"
    ):
        settled.lines.left([CASE], seals)
    opened(settled, [CASE])
    with pytest.raises(
        ValueError, match=r"ledger\.jsonl: case 0000031 was drawn by other settings"
    ):
        settled.lines.left([other])


HYPOTHESIS = observations.hypothesis((), [1.0], 0.5)
SEARCHED = Entry(OTHER.id, opened=OTHER, seconds=2.0, evidence=observations.case([HYPOTHESIS]),
                 rank=1, weak=("slow",), steps=({"name": "coasting", "true": 1.0},))  # fmt: skip
FAILED = Entry(CASE.id, "recall", CASE, failed="ValueError: it spins")


def test_searched_and_asked_cases_are_lines_of_one_ledger(settled):
    ledger = settled.lines
    ledger.enter([SEARCHED])
    [told, other] = ledger.entries()
    assert (told, other) == (asked(settled.store, [CASE])[0], SEARCHED)
    assert searched([ledger.file]) == [SEARCHED]


def test_nothing_is_calibrated_on_a_sealed_seed(tmp_path):
    ledger = Ledger(tmp_path / "ledger.jsonl")
    ledger.enter([replace(SEARCHED, kind="sealed"), FAILED])
    with pytest.raises(ValueError, match="case 0000032 has a sealed seed"):
        searched([ledger.file])


def test_a_line_from_before_lines_had_a_kind_is_a_development_case(tmp_path):
    old = tmp_path / "old.jsonl"
    lines = [SEARCHED.to_dict(), FAILED.to_dict() | {"hypotheses": []}]
    for line in lines:
        del line["kind"], line["id"]
    old.write_text("".join(json.dumps(line) + "\n" for line in lines))
    assert Ledger(old).entries() == [SEARCHED, replace(FAILED, kind="development")]


def test_a_packed_ledger_holds_the_same_lines(tmp_path):
    plain, packed = Ledger(tmp_path / "plain.jsonl"), Ledger(tmp_path / "packed.jsonl.gz")
    plain.enter([SEARCHED])
    plain.enter([FAILED])
    packed.file.write_bytes(gzip.compress(plain.file.read_bytes()))
    assert plain.entries() == packed.entries() == [SEARCHED, FAILED]


@pytest.mark.parametrize(
    "line",
    ["{", "[]", "{}", '{"case": {"seed": 1}, "hypotheses": []}', '{"id": "0000031", "seal": "a"}',
     '{"kind": "tuned", "id": "1", "answers": {}}', '{"id": "1", "answers": {"ours": {}}}'],
)  # fmt: skip
def test_a_line_that_is_none_is_named(tmp_path, line):
    ledger = Ledger(tmp_path / "ledger.jsonl")
    ledger.enter([SEARCHED])
    ledger.file.write_text(ledger.file.read_text() + line + "\n")
    with pytest.raises(ValueError, match=r"ledger\.jsonl, line 2: no case of a ledger"):
        ledger.left([CASE])


def test_hashes_stand_before_any_drive_and_are_those_of_what_is_sealed_later(config):
    store = config.store
    before = store.hashes.read_text()
    seal(store, [OTHER], [])
    assert store.hashes.read_text() == before
    assert [store.sealed_case(case.id) for case in (CASE, OTHER)] == [CASE, OTHER]
    publish(store, [OTHER, Case(33, "reference", "reference", seconds=1.3)])
    assert store.hashes.read_text().startswith(before)
    with pytest.raises(ValueError, match="another hash of case 0000033"):
        publish(store, [Case(33, "reference", "reference", seconds=1.4)])


def test_an_answer_that_was_asked_about_and_is_gone_is_missed(config):
    config.store.truth(CASE.id).unlink()
    with pytest.raises(FileNotFoundError, match="missing"):
        opened(config, [CASE])


def test_the_hash_can_be_checked_by_hand(config):
    content = json.loads(config.store.truth(CASE.id).read_text())
    assert content["case"] == asdict(CASE)
    assert set(config.store.digests()) == {CASE.id, OTHER.id}


def test_the_kind_of_a_run_is_that_of_its_seeds(config):
    sealed = replace(config, draw=DrawConfig(split="sealed"))
    write_json(config.store.oracle(CASE.id), WEIGHED)
    settle(sealed, [CASE])
    assert [entry.kind for entry in config.lines.entries()] == ["sealed"]


def test_openings_are_counted(tmp_path):
    file = tmp_path / "opened.json"
    assert openings(file) == 0
    assert [open_once(file), open_once(file), openings(file)] == [1, 2, 2]
