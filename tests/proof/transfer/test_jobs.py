"""The commands of the study, read by the configs of the scripts that they call."""

from pathlib import Path

import pytest

from buggy_rl.core.config import build, plain_values
from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.estimation.fit_study import StudyConfig, fit_file, model_file, model_runs
from buggy_rl.policies.training.run import PolicyRunConfig
from buggy_rl.proof.transfer.arms import ARMS
from buggy_rl.proof.transfer.jobs import diagnosis_jobs, fit_jobs, model_jobs, training_jobs
from buggy_rl.proof.transfer.plan import TransferConfig

SCRIPTS = Path("scripts")


@pytest.fixture
def config(monkeypatch, repository) -> TransferConfig:
    monkeypatch.chdir(repository)
    return TransferConfig("out", cars=1, seeds=[5], steps=1000)


def options(job) -> list[str]:
    return list(job.command[1:])


def runs(config, started):
    jobs = training_jobs(config, SCRIPTS, started)
    return {job.name.split(",")[0]: build(PolicyRunConfig, options(job)) for job in jobs}


def test_trainings_differ_in_the_engine_alone(config):
    plain = [plain_values(run) for run in runs(config, started=False).values()]
    engines = [run.pop("engine")["simulator"] for run in plain]
    outputs = [run.pop("output") for run in plain]
    assert len(set(engines)) == len(set(outputs)) == len(ARMS) - 1
    assert all(run == plain[0] for run in plain)
    assert (plain[0]["algorithm"], plain[0]["shac"]["steps"]) == ("shac", 1000)
    assert (plain[0]["seed"], plain[0]["shac"]["seed"]) == (5, 5)


def test_training_on_begins_with_the_policy_as_given_in_the_repaired_simulator(config):
    new, (started,) = runs(config, started=False), runs(config, started=True).values()
    assert started.start == f"{new['as_given'].output}/best.pt"
    repaired = Path(new["repaired"].engine.simulator)
    assert Path(started.engine.simulator) == repaired.with_name("continued.yaml")
    assert started.shac.steps == 100
    assert started.shac.schedule == "constant"
    (job,) = training_jobs(config, SCRIPTS, started=True)
    assert started.start in job.inputs


def test_a_policy_hangs_on_its_settings_and_on_the_car_it_was_trained_in(config):
    made = {job.name: job.inputs for job in training_jobs(config, SCRIPTS, started=False)}
    settings = ("configs/shac.yaml", "configs/ppo_car.yaml")
    assert made["repaired, 01, 5"] == (*settings, "out/cars/01/simulators/repaired.yaml")
    assert made["randomised, 01, 5"] == (*settings, "out/cars/01/simulators/randomised.py:make")


def test_the_diagnosis_is_told_drives_and_simulator_and_nothing_of_what_is_concealed(config):
    (job,) = diagnosis_jobs(config, SCRIPTS)
    asked = build(DiagnosisConfig, options(job))
    assert asked.simulator == str(config.fitted("01"))
    assert asked.recordings == ["out/cars/01/recordings"]
    assert asked.baseline == ["out/cars/01/baseline"]
    assert f"{asked.output}/repaired.yaml" == str(config.repaired("01"))
    (case,) = config.drawn("a secret").values()
    assert case.concealed
    assert not any(effect in part for effect in case.concealed for part in job.command)


def test_both_fits_are_of_two_minutes_by_the_same_options(config):
    fit, refit = [build(StudyConfig, options(job)) for job in fit_jobs(config, SCRIPTS)]
    assert [str(Path(s.output) / fit_file(s)) for s in (fit, refit)] == [
        str(config.fitted("01")),
        str(config.fitted("01", "refit")),
    ]
    assert fit.fit == refit.fit
    # Two earlier drives are kept back: four of six are left, as there are four after the change.
    assert fit.data.recordings == ["out/cars/01/earlier"]
    assert refit.data.recordings == [
        "out/cars/01/recordings",
        "out/cars/01/earlier/earlier_0.csv",
        "out/cars/01/earlier/earlier_1.csv",
    ]
    for study in (fit, refit):
        assert (study.data.held_out, study.data.validation) == (["earlier_0"], ["earlier_1"])


def test_learned_models_lie_where_simulators_look_for_them(config):
    before, learned = [build(StudyConfig, options(job)) for job in model_jobs(config, SCRIPTS)]
    for study, folder in ((before, "before"), (learned, "learned")):
        ((name, model, training),) = model_runs(study)
        assert model_file(study, name) == config.model_of("01", folder)
        assert (model.kind, training.loss) == ("mlp", "rollout")
    assert before.data.recordings == ["out/cars/01/earlier"]
    assert learned.data.recordings == ["out/cars/01/recordings", "out/cars/01/earlier"]
    assert learned.data.validation == ["drive_3"]


def test_arms_that_are_not_wanted_cost_nothing(config):
    lean = TransferConfig("out", cars=1, arms=["as_given", "randomised"])
    assert diagnosis_jobs(lean, SCRIPTS) == []
    assert len(fit_jobs(lean, SCRIPTS)) == 1
    assert [job.folder.name for job in model_jobs(lean, SCRIPTS)] == ["before"]
