"""The factory of development cases, small: recorded, searched, written down, and never twice."""

from pathlib import Path

import pytest

from buggy_rl.diagnosis.search.posterior import shipped
from buggy_rl.proof.calibrate.development import DevelopmentConfig
from buggy_rl.proof.calibrate.discrimination import PRICE
from buggy_rl.proof.calibrate.intervals import steps
from buggy_rl.proof.cases.draw import DrawConfig
from buggy_rl.proof.ledger import Entry, Ledger
from tests.proof.here import jobs_here
from tests.running import Done, run_script

pytestmark = pytest.mark.slow

OPTIONS = (
    "draw.each=true", "draw.nothing=1", "draw.cases=3", "draw.seconds=[6.0]",
    "draw.pairings=[reference]", "draw.nuisances=[white]", "draw.driving=[rich]",
    "draw.families=[one]", "draw.spread=[0.08]",
    "draw.names=[steering_gain,gyro_bias]", "stretches=12",
    "effects=[steering_gain,gyro_bias]",
)  # fmt: skip


def develop(folder: Path) -> Done:
    options = ["configs/development.yaml", f"output={folder}", *OPTIONS]
    with jobs_here():
        return run_script("scripts/develop.py", *options)


def entries(folder: Path) -> list[Entry]:
    return Ledger(folder / "development.jsonl").entries()


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> tuple[Path, Done]:
    folder = tmp_path_factory.mktemp("development") / "run"
    return folder, develop(folder)


@pytest.mark.timeout(900)
def test_the_truth_is_the_most_evident_and_nothing_is_where_nothing_is(run):
    folder, done = run
    assert done.returncode == 0, done.stderr
    found = entries(folder)
    assert len(found) == 3
    for entry in found:
        truth = entry.case.truth
        assert entry.case.spread == 0.08  # nor is the car the one that the library knows
        best = max(
            entry.seen.hypotheses,
            key=lambda h: h.evidence.log_evidence - PRICE * len(h.effects),
        )
        assert best.effects == truth
        assert entry.rank == (1 if truth else 0)
        for effect, values in entry.case.concealed.items():
            for name, value in values.items():
                assert best.values[effect][name] == pytest.approx(value, rel=0.1)
    assert "too few to tell apart" in done.stdout


def test_what_is_logged_is_what_a_calibration_asks_for(run):
    entry = entries(run[0])[0]
    assert (entry.kind, entry.seal) == ("development", "")
    every = {(), ("steering_gain",), ("gyro_bias",), ("gyro_bias", "steering_gain")}
    assert {h.effects for h in entry.seen.hypotheses} == every
    for hypothesis in entry.seen.hypotheses:
        assert len(hypothesis.z) == len(hypothesis.sd)
        assert len(hypothesis.held_out) >= 2
        assert set(hypothesis.varies) == set(hypothesis.effects)


def test_what_step_tests_say_is_logged_beside_the_cars_own(run):
    for entry in entries(run[0]):
        told = steps([entry])
        if entry.case.truth == ("gyro_bias",):  # of the sensor: no truth
            assert told == []
            continue
        assert {"acceleration", "steering_response"} <= {step.name for step in told}
        held = [step.inside(shipped().step_error) for step in told]
        assert sum(held) >= len(held) - 1


@pytest.mark.timeout(900)
def test_what_is_done_is_not_done_again_and_leaves_no_files(run):
    folder, _ = run
    ledger = folder / "development.jsonl"
    before = ledger.read_bytes()
    assert develop(folder).returncode == 0
    assert ledger.read_bytes() == before
    assert not list((folder / "cases").iterdir())
    assert not list((folder / "truth").glob("*.json"))


def test_nothing_is_calibrated_on_sealed_seeds():
    with pytest.raises(ValueError, match="sealed seeds"):
        DevelopmentConfig(output="x", draw=DrawConfig(split="sealed"))
