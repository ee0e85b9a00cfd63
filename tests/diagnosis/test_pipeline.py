"""The whole way from drives to an answer, on small drives of a single-track car."""

from dataclasses import replace

import pytest
import torch
import yaml

from buggy_rl.diagnosis import pipeline
from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.diagnosis.integration import Step
from buggy_rl.diagnosis.pipeline import diagnose
from buggy_rl.diagnosis.repair import repaired
from buggy_rl.diagnosis.search import Search
from buggy_rl.estimation.gauss_newton import Fitter
from buggy_rl.estimation.noise_model import likelihood
from buggy_rl.estimation.segments import stretches
from buggy_rl.task.env import make_simulator
from tests.diagnosis.planted import fitter, planted_drives

CONFIG = DiagnosisConfig(
    simulator="single_track",
    recordings=["made in the test"],
    output="nowhere",
    effects=["throttle_gain", "viscous_drag", "steering_dead_time"],
    parameters=False,
    stretches=40,
)
ONE = replace(CONFIG, effects=["throttle_gain"])  # for what does not hang on the answer


@pytest.fixture(scope="module")
def recordings():
    return planted_drives([{"throttle_gain": {"gain": 0.7}}], seconds=18.0)[0]


@pytest.fixture(scope="module")
def done(recordings):
    return diagnose(CONFIG, recordings)


def numbers(answer):
    return {n.name: {p: v.value for p, v in n.parameters.items()} for n in answer.effects}


@pytest.mark.slow  # beside other work, two threads wait for one another for minutes
def test_one_thread_and_two_give_the_same_answer(recordings, done):
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        again = diagnose(replace(CONFIG, threads=2), recordings)
    finally:
        torch.set_num_threads(before)
    assert again.answer.verdict == done.answer.verdict
    first, second = numbers(done.answer), numbers(again.answer)
    assert list(first) == list(second) == ["throttle_gain"]
    assert second["throttle_gain"] == pytest.approx(first["throttle_gain"], rel=1e-6)
    assert again.answer.effects[0].confidence == pytest.approx(
        done.answer.effects[0].confidence, rel=1e-6
    )


def test_an_interrupted_diagnosis_goes_on_where_it_stopped(recordings, done, tmp_path, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    kept = tmp_path / "stages"
    with monkeypatch.context() as patched:
        patched.setattr(pipeline, "stated", interrupted)
        with pytest.raises(KeyboardInterrupt):
            diagnose(CONFIG, recordings, kept=kept)
    monkeypatch.setattr(pipeline, "identified", interrupted)  # it is not asked again
    again = diagnose(CONFIG, recordings, kept=kept)
    assert numbers(again.answer) == numbers(done.answer)
    # Another question is not answered by what was kept.
    with pytest.raises(KeyboardInterrupt):
        diagnose(replace(CONFIG, seconds=0.9), recordings, kept=kept)


def test_the_repair_beats_retuning_and_a_network_on_what_was_held_out(done):
    proof = done.answer.proof
    assert proof.after[1.0] < 0.1 * proof.before[1.0]
    assert proof.after[1.0] < proof.black_box[1.0] < proof.before[1.0]
    # A factor of the motor's pull is not what trims of both channels and their gains can hide:
    # they can, but no better than the cause itself.
    assert proof.retuned[1.0] < 0.5 * proof.before[1.0]
    assert set(proof.after) == {0.3, 1.0, 3.0}


def test_what_an_effect_must_know_of_the_simulator_stays_in_the_repaired_one(done, tmp_path):
    content = repaired(CONFIG.simulator, done.answer, tmp_path, options=done.case.player.options)
    # The single track's deadband of 0.05, as it shows in how it drives.
    assert content["effects"]["throttle_gain"]["onset"] == pytest.approx(0.05, abs=0.005)
    file = tmp_path / "repaired.yaml"
    file.write_text(yaml.safe_dump(content))
    assert [t.name for t in make_simulator(file, 2).transform] == ["throttle_gain"]


def test_what_the_baseline_lacks_as_well_has_not_changed():
    # Both cars steer too little; only the later one has drag as well.
    standing = {"steering_gain": {"gain": 0.8}}
    before, after = planted_drives([standing, {**standing, "viscous_drag": {"rate": 0.5}}])
    named = ["steering_gain", "viscous_drag"]
    fit = fitter(after, named)
    cut = stretches(before, 1.0, 1.0)
    baseline = Fitter(fit.player, cut, likelihood(fit.player, cut), fit.library)
    assert set(Search(fitter(after, named)).run().best.causes) == set(named)
    assert Search(fit, baseline=baseline).run().best.causes == ("viscous_drag",)


def test_another_step_is_looked_with_told_and_given_back(recordings, tmp_path, monkeypatch):
    # When a step is too coarse is another test's. Here a coarser one is taken, which is quick.
    assert make_simulator(CONFIG.simulator, 1).substeps != 1
    step = Step({"substeps": 1}, "another step")
    monkeypatch.setattr(pipeline, "fine_enough", lambda *_: step)
    done = diagnose(replace(ONE, seconds=0.5), recordings)
    assert done.case.player.make(1).substeps == 1
    assert "another step" in done.answer.notes
    file = tmp_path / "repaired.yaml"
    file.write_text(
        yaml.safe_dump(repaired(CONFIG.simulator, done.answer, tmp_path, step=done.step))
    )
    assert make_simulator(file, 1).substeps == 1
    given = tmp_path / "given.yaml"  # one that says so itself gives way
    given.write_text(yaml.safe_dump({"engine": "single_track", "options": {"substeps": 3}}))
    file.write_text(yaml.safe_dump(repaired(str(given), done.answer, tmp_path, step=done.step)))
    assert make_simulator(file, 1).substeps == 1


def test_a_users_own_factory_is_not_asked_for_another_step(recordings, tmp_path, monkeypatch):
    # It may return one of our engines, and takes none of its options.
    own = tmp_path / "own.py"
    own.write_text(
        "from buggy_rl.engines import make_engine\n\n"
        "def make(batch_size, device):\n"
        "    return make_engine('single_track', batch_size, device)\n"
    )
    monkeypatch.setattr(pipeline, "fine_enough", lambda *_: Step({"substeps": 4}, "too coarse"))
    assert pipeline._step(replace(ONE, simulator=f"{own}:make"), recordings) == Step()
    assert pipeline._step(ONE, recordings).options
