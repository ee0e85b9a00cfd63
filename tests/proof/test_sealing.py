"""Sealing: nothing of the answer can be seen, and the answer cannot be changed."""

import hashlib
import json
import re

import pandas as pd
import pytest

from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.sealing import TOGETHER, CaseStore, groups, publish, seal
from buggy_rl.proof.cases.sizes import SIZES, UNKNOWN_SIZES
from buggy_rl.recordings import load_recordings

CASES = [
    Case(11, "reference", "reference", False,
         {"payload": {"mass_ratio": 1.3217}, "gyro_bias": {"bias": 0.1439}}, "jitter", seconds=1.6),
    Case(12, "reference", "reference", True,
         {"sticky_servo": {"breakaway": 0.2713}}, "parameters_3", seconds=1.6),
    Case(13, "reference", "reference", seconds=1.6, nuisance="coloured", driving="steady"),
]  # fmt: skip


def store(folder) -> CaseStore:
    made = CaseStore(folder / "open", folder / "safe")
    for place in (made.output, made.sealed):
        place.mkdir(parents=True)
    return made


@pytest.fixture(scope="module")
def sealed(tmp_path_factory) -> CaseStore:
    made = store(tmp_path_factory.mktemp("sealed"))
    assert seal(made, CASES, []) == 3
    publish(made, CASES)
    return made


def files(folder) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_what_may_be_seen_is_a_question_a_simulator_and_drives(sealed):
    assert set(files(sealed.inputs("0000012"))) == {
        "question.yaml",
        "simulator.yaml",
        *(f"{kind}/drive_{n}.csv" for kind in ("recordings", "baseline") for n in (0, 1)),
    }
    assert set(files(sealed.inputs("0000013"))) == {
        "question.yaml",
        "simulator.yaml",
        "recordings/drive_0.csv",
        "recordings/drive_1.csv",
    }


def test_what_may_be_seen_names_no_effect_no_number_and_no_nuisance(sealed):
    told = {*SIZES, *UNKNOWN_SIZES, *(p for s in SIZES.values() for p in s if len(p) > 6)}
    told |= {"coloured", "jitter", "parameters_3", "steady", "concealed", "salt", "sealed"}
    for case in CASES:
        for name, content in files(sealed.inputs(case.id)).items():
            # Names of the car's own parameters are part of a simulator: that it has a steering
            # lag says nothing of what is wrong with it.
            words = set(re.findall(r"[a-z_0-9]+", f"{name} {content.decode()}"))
            if name == "simulator.yaml":
                words -= {"steering_lag", "rolling_resistance", "aerodynamic_drag",
                          "throttle_deadband", "steering_drag", "gear_ratio"}  # fmt: skip
            assert not words & told, name
            for values in case.concealed.values():
                for value in values.values():
                    assert f"{value:g}" not in re.findall(r"-?\d+\.\d+", content.decode())


def test_the_drives_are_recordings_as_any_other(sealed):
    for case in CASES:
        recordings, refusals = load_recordings([str(sealed.inputs(case.id) / "recordings")])
        assert (len(recordings), refusals) == (2, [])
        held_out, refusals = load_recordings([str(sealed.held_out(case.id))])
        assert (len(held_out), refusals) == (1, [])
    columns = pd.read_csv(sealed.inputs("0000011") / "recordings" / "drive_0.csv").columns
    expected = ["t", "x", "y", "yaw", "vx", "vy", "yaw_rate", "throttle", "steering"]
    assert list(columns) == expected


def test_same_seed_same_bytes_whatever_is_made_beside_it(sealed, tmp_path):
    again = store(tmp_path)
    seal(again, [CASES[1]], [])
    for one, other in (
        (sealed.inputs("0000012"), again.inputs("0000012")),
        (sealed.held_out("0000012"), again.held_out("0000012")),
    ):
        assert files(one) == files(other)
    assert sealed.truth("0000012").read_bytes() == again.truth("0000012").read_bytes()


def test_hashes_are_those_of_the_answers_and_the_salt_is_not_seen(sealed):
    lines = dict(reversed(line.split()) for line in sealed.hashes.read_text().splitlines())
    assert set(lines) == {case.id for case in CASES}
    for case in CASES:
        content = sealed.truth(case.id).read_bytes()
        assert hashlib.sha256(content).hexdigest() == lines[case.id]
        assert len(json.loads(content)["salt"]) == 32
    assert [sealed.sealed_case(case.id) for case in CASES] == CASES


def test_an_answer_that_was_changed_afterwards_is_noticed(tmp_path):
    made = store(tmp_path)
    short = [Case(13, "reference", "reference", seconds=1.2)]
    seal(made, short, [])
    publish(made, short)
    text = made.truth("0000013").read_text()
    made.truth("0000013").write_text(text.replace('"rich"', '"steady"'))
    with pytest.raises(ValueError, match="not what was sealed"):
        made.sealed_case("0000013")
    with pytest.raises(ValueError, match="sealed by other settings"):
        publish(made, short)
    made.truth("0000013").write_text(text + " ")
    with pytest.raises(ValueError, match="not changed after they were published"):
        publish(made, short)


def test_cases_are_driven_together_only_where_plant_and_length_agree():
    cases = [Case(n, "reference", "reference", seconds=20.0 + n % 2) for n in range(40)]
    cases += [Case(n, "mujoco", "mujoco") for n in range(40, 43)]
    made = groups(cases)
    assert sorted(case.seed for group in made for case in group) == list(range(43))
    for group in made:
        assert len({(case.plant, case.seconds) for case in group}) == 1
        assert len(group) <= (TOGETHER if group[0].plant == "reference" else 1)
