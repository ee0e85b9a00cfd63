"""From recordings to an answer, on short recordings of a single-track car."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch
import yaml

from buggy_rl.diagnosis import pipeline
from buggy_rl.diagnosis.pipeline import run_diagnosis
from buggy_rl.diagnosis.preflight.commands import CommandCheck
from buggy_rl.diagnosis.repaired import repaired_simulator
from buggy_rl.diagnosis.run import maker
from buggy_rl.diagnosis.run.budget import FULL, smaller
from buggy_rl.diagnosis.run.case import Criteria, Drives
from buggy_rl.diagnosis.run.maker import IntegrationStep
from buggy_rl.diagnosis.search.joint import joint_search
from buggy_rl.diagnosis.search.observed import search_evidence
from buggy_rl.diagnosis.search.posterior import of_hypotheses
from buggy_rl.estimation import baseline as training
from buggy_rl.estimation.evidence import blocks
from buggy_rl.task.env import make_simulator
from tests.diagnosis.conftest import ASKED, SMALL
from tests.diagnosis.planted import planted_drives, problem_of

ONE = replace(SMALL, effects=["throttle_gain"])


@pytest.fixture
def recordings(long_drives):
    return long_drives["weak"]


def numbers(answer):
    return {n.name: {p: v.value for p, v in n.parameters.items()} for n in answer.effects}


@pytest.mark.slow  # on a busy machine two threads wait for each other for minutes
def test_one_thread_and_two_give_the_same_answer(recordings, weak):
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        again = run_diagnosis(replace(ASKED, threads=2), recordings)
    finally:
        torch.set_num_threads(before)
    assert again.answer.verdict == weak.answer.verdict
    first, second = numbers(weak.answer), numbers(again.answer)
    assert list(first) == list(second) == ["throttle_gain"]
    assert second["throttle_gain"] == pytest.approx(first["throttle_gain"], rel=1e-6)
    assert again.answer.effects[0].confidence == pytest.approx(
        weak.answer.effects[0].confidence, rel=1e-6
    )


def test_an_interrupted_diagnosis_resumes_at_the_stage_it_was_in(
    recordings, weak, tmp_path, monkeypatch
):
    resumed = []

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    def told(case, found, *_):
        resumed.append(found.best.key)
        return weak.answer

    kept = tmp_path / "stages"
    with monkeypatch.context() as patched:
        patched.setattr(pipeline, "answered", interrupted)
        with pytest.raises(KeyboardInterrupt):
            run_diagnosis(ONE, recordings, kept=kept)
    monkeypatch.setattr(pipeline, "joint_search", interrupted)  # it is kept, and does not run again
    monkeypatch.setattr(pipeline, "answered", told)
    again = run_diagnosis(ONE, recordings, kept=kept)
    assert resumed == [("throttle_gain",)]
    assert again.answer.effects == weak.answer.effects
    # Another configuration does not take what was kept.
    with pytest.raises(KeyboardInterrupt):
        run_diagnosis(replace(ONE, seconds=0.9), recordings, kept=kept)


def test_the_repair_beats_retuning_and_a_network_on_held_out_blocks(weak):
    proof = weak.answer.proof
    assert proof.after[1.0] < 0.1 * proof.before[1.0]
    assert proof.after[1.0] < proof.black_box[1.0] < proof.before[1.0]
    # Gains and offsets of both channels hide a factor of the drive force, but no better than the
    # effect itself.
    assert proof.retuned[1.0] < 0.5 * proof.before[1.0]
    assert set(proof.after) == {0.3, 1.0, 3.0}


def test_options_of_an_effect_are_kept_in_the_repaired_simulator(weak, tmp_path):
    content = repaired_simulator(ASKED.simulator, weak, tmp_path)
    # The single track's deadband of 0.05, as it shows in how it drives.
    assert content["effects"]["throttle_gain"]["onset"] == pytest.approx(0.05, abs=0.005)
    file = tmp_path / "repaired.yaml"
    file.write_text(yaml.safe_dump(content))
    own, *others = [t.name for t in make_simulator(file, 2).transform]
    assert own == "throttle_gain"
    assert others == [term.name for term in weak.answer.terms]


def test_an_effect_that_the_baseline_has_too_gains_there_likewise():
    # Both cars steer too little; only the later one has drag as well.
    standing = {"steering_gain": {"gain": 0.8}}
    before, after = planted_drives([standing, {**standing, "viscous_drag": {"rate": 0.5}}])
    named = ["steering_gain", "viscous_drag"]
    problem, baseline = (problem_of(recordings, named) for recordings in (after, before))
    criteria = Criteria(blocks(problem.segments), baseline=baseline)
    found = joint_search(problem, criteria, budget=replace(FULL, rounds=1, refitted=0))
    seen = search_evidence(criteria, found)
    share = {
        h.effects: f["on_baseline"]
        for h, f in zip(seen.hypotheses, of_hypotheses(seen), strict=True)
    }
    assert share["steering_gain",] < -0.5  # of what it gains: it is nothing that changed
    assert share["viscous_drag",] > -0.1


@pytest.mark.slow
def test_another_step_is_used_noted_and_written_to_the_repaired_simulator(
    recordings, tmp_path, monkeypatch
):
    monkeypatch.setattr(training, "STEPS", 50)
    # A coarser step, which is quick.
    assert make_simulator(ASKED.simulator, 1).substeps != 1
    step = IntegrationStep({"substeps": 1}, "another step")
    monkeypatch.setattr(maker, "fine_enough", lambda *_: step)
    done = run_diagnosis(replace(ONE, seconds=0.5), recordings)
    assert done.case.problem.simulation.make(1).substeps == 1
    assert "another step" in done.answer.notes
    file = tmp_path / "repaired.yaml"
    file.write_text(yaml.safe_dump(repaired_simulator(ASKED.simulator, done, tmp_path)))
    assert make_simulator(file, 1).substeps == 1
    given = tmp_path / "given.yaml"  # its own step is overridden
    given.write_text(yaml.safe_dump({"engine": "single_track", "options": {"substeps": 3}}))
    file.write_text(yaml.safe_dump(repaired_simulator(str(given), done, tmp_path)))
    assert make_simulator(file, 1).substeps == 1


def test_the_step_of_a_users_own_factory_is_left_alone(recordings, tmp_path, monkeypatch):
    # It may return one of our engines, and takes none of its options.
    own = tmp_path / "own.py"
    own.write_text(
        "from buggy_rl.simulators import make_engine\n\n"
        "def make(batch_size, device):\n"
        "    return make_engine('single_track', batch_size, device)\n"
    )
    monkeypatch.setattr(
        maker, "fine_enough", lambda *_: IntegrationStep({"substeps": 4}, "too coarse")
    )
    drives = Drives.cut(ONE, recordings)
    assert maker._step(replace(ONE, simulator=f"{own}:make"), drives) == IntegrationStep()
    assert maker._step(ONE, drives).options


def test_after_the_deadline_what_is_optional_is_left_out_and_said(recordings, monkeypatch):
    monkeypatch.setattr(training, "STEPS", 50)
    answer = run_diagnosis(replace(ONE, minutes=1e-3), recordings).answer
    assert "left out: what to drive next; minutes=0.001 were up" in answer.notes
    assert answer.proof.after[1.0] > 0.0  # what is not optional is there


@pytest.mark.parametrize(("minutes", "expected"), [(10.0, [*smaller()][-1]), (0.0, FULL)])
def test_commands_that_do_not_predict_the_motion_get_the_shortest_search_unless_told_otherwise(
    recordings, monkeypatch, minutes, expected
):
    class BudgetedError(Exception):
        pass

    def case(*arguments):
        raise BudgetedError(arguments[-1])

    monkeypatch.setattr(pipeline, "check_commands", lambda _: CommandCheck(["They do not."], []))
    monkeypatch.setattr(pipeline, "prepare_case", case)
    with pytest.raises(BudgetedError) as budget:
        run_diagnosis(replace(ONE, minutes=minutes), recordings)
    assert budget.value.args == (expected,)


@pytest.mark.parametrize(
    ("short", "baseline", "parameters"), [(True, None, 1), (False, "drives", 1), (False, None, 0)]
)
def test_parameters_are_not_fitted_where_they_were_right_or_are_none(
    monkeypatch, short, baseline, parameters
):
    library = SimpleNamespace(parameters=dict.fromkeys(range(parameters)))
    problem = SimpleNamespace(library=library)
    case = SimpleNamespace(drives=SimpleNamespace(baseline=baseline), problem=problem)
    found = SimpleNamespace(posterior=None, best=SimpleNamespace(effects=()))
    done = SimpleNamespace(case=case, found=found, answer=SimpleNamespace(proof=None))
    monkeypatch.setattr(pipeline, "left_open", lambda *_: pytest.fail("it is looked at again"))
    assert pipeline._retuned_too(None, done, None, None, short) is done
