"""From recordings to an answer on short recordings of a single-track car."""

import json
from dataclasses import replace

import pytest

from buggy_rl.diagnosis.pipeline import run_diagnosis
from buggy_rl.diagnosis.repaired import repaired_simulator
from tests.diagnosis.conftest import ASKED, SMALL


def test_what_is_planted_is_named_first_and_closes_the_residual(weak):
    answer = weak.answer
    assert answer.verdict == "missing_physics"
    first = answer.effects[0]
    assert first.name == "throttle_gain"
    assert first.confidence > 0.5
    assert first.parameters["gain"].value < 0.8
    assert answer.proof.misfit_after < 0.3 * answer.proof.misfit_before


def test_nothing_is_named_where_nothing_is(right):
    assert right.answer.verdict == "no_mismatch"
    assert right.answer.effects == []
    assert "effects" not in repaired_simulator("single_track", right, folder=None)  # type: ignore[arg-type]


def test_probabilities_are_written_and_sum_to_one(weak):
    written = json.loads(json.dumps(weak.answer.to_dict()))
    posterior = written["posterior"]
    sets = posterior["sets"]
    total = posterior["nothing"] + posterior["unknown"] + sum(s["probability"] for s in sets)
    assert total == pytest.approx(1.0)
    assert sets[0]["effects"] == ["throttle_gain"]
    assert [s["probability"] for s in sets] == sorted(
        (s["probability"] for s in sets), reverse=True
    )
    confidence = sum(s["probability"] for s in sets if "throttle_gain" in s["effects"])
    assert written["effects"][0]["confidence"] == pytest.approx(confidence)
    assert all(t["log_evidence"] is not None for t in written["tried"])
    names = [e for e in written["effects"] if e["kind"] != "term"]
    assert all(e["confidence"] >= 0.02 for e in names)
    assert [e["confidence"] for e in names] == sorted(
        (e["confidence"] for e in names), reverse=True
    )


@pytest.mark.slow
def test_a_short_time_is_kept_by_rolling_out_less_and_the_answer_says_what_was_left_out(
    long_drives,
):
    readings = []
    done = run_diagnosis(replace(ASKED, minutes=0.01), long_drives["weak"], show=readings.append)
    [lost] = [note for note in done.answer.notes if "environment steps a second: " in note]
    assert "16 of 24 segments, 4 of 16 sets, 1 of 10 iterations" in lost
    assert lost in done.answer.to_dict()["notes"]
    assert len(done.case.problem.segments) == 16
    assert done.answer.effects[0].name == "throttle_gain"
    assert readings[0].left > 0  # before anything was rolled out
    first, last = readings[0], readings[-1]
    # In steps, since clocks may stall; parts for which time was up are not rolled out.
    assert last.done <= last.planned < 1.2 * first.planned
    counts = [reading.done for reading in readings]
    assert counts == sorted(counts)


@pytest.mark.slow
def test_an_interrupted_search_goes_on_in_the_round_in_which_it_was_stopped(
    long_drives, small, tmp_path
):
    told, recordings = [], long_drives["weak"]

    def stopped(text):
        told.append(text)
        if text.startswith("looking about"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_diagnosis(SMALL, recordings, stopped, kept=tmp_path)
    assert any(text.startswith("rolling out") for text in told)
    told.clear()
    done = run_diagnosis(SMALL, recordings, told.append, kept=tmp_path)
    assert not any(text.startswith(("rolling out", "fitting")) for text in told)
    assert small.answer.effects[0].name == "throttle_gain"
    assert done.answer.to_dict() == small.answer.to_dict()
