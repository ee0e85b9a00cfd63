"""The commands of the study, read by the configs of the scripts that they call."""

from pathlib import Path

import pytest

from buggy_rl.core.config import build, plain_values
from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.estimation.fit_study import StudyConfig, model_file, model_runs
from buggy_rl.policies.training.run import PolicyRunConfig
from buggy_rl.proof.transfer.jobs import diagnosis_jobs, models, training_jobs
from buggy_rl.proof.transfer.plan import ARMS, TransferConfig

CARS = {"late": {"steering_dead_time": {"dead_time": 0.08}}}


@pytest.fixture
def config(monkeypatch, repository) -> TransferConfig:
    monkeypatch.chdir(repository)
    return TransferConfig("out", cars=CARS, seeds=[5], steps=1000)


def options(job) -> list[str]:
    return list(job.command[1:])


def test_the_four_trainings_differ_in_the_engine_alone(config):
    runs = [
        plain_values(build(PolicyRunConfig, options(j)))
        for j in training_jobs(config, Path("scripts"))
    ]
    engines = [run.pop("engine")["simulator"] for run in runs]
    outputs = [run.pop("output") for run in runs]
    assert len(set(engines)) == len(set(outputs)) == len(ARMS)
    assert all(run == runs[0] for run in runs)
    assert (runs[0]["ppo"]["steps"], runs[0]["ppo"]["seed"], runs[0]["seed"]) == (1000, 5, 5)


def test_the_diagnosis_is_told_drives_and_simulator_and_nothing_of_what_is_concealed(config):
    (job,) = diagnosis_jobs(config, Path("scripts"))
    asked = build(DiagnosisConfig, options(job))
    assert asked.simulator == config.simulator
    assert asked.recordings == ["out/cars/late/recordings"]
    assert asked.baseline == ["out/cars/late/baseline"]
    assert f"{asked.output}/repaired.yaml" == config.made_from("repaired", "late")
    assert not any("dead_time" in part for part in job.command)


def test_the_learned_model_lies_where_the_policy_looks_for_it(config):
    (job,) = models(config, Path("scripts"))
    study = build(StudyConfig, options(job))
    ((name, model, training),) = model_runs(study)
    assert str(model_file(study, name)) == config.simulator_of("learned", "late")
    assert (model.kind, training.loss) == ("mlp", "rollout")
    # The drive that only judges is not one of the two minutes.
    assert study.data.held_out == ["before_0"]
    assert study.data.validation == ["drive_3"]


def test_a_policy_hangs_on_its_settings_and_on_the_car_it_was_trained_in(config):
    made = {job.name: job.inputs for job in training_jobs(config, Path("scripts"))}
    settings = ("configs/ppo.yaml", "configs/ppo_car.yaml")
    assert made == {
        "unrepaired, 5": (*settings, config.simulator),
        "randomised, 5": (*settings, config.simulator),
        "repaired, late, 5": (*settings, "out/cars/late/diagnosis/repaired.yaml"),
        "learned, late, 5": (*settings, "out/cars/late/learned/models/model.pt"),
    }


def test_arms_that_are_not_wanted_cost_nothing(config):
    lean = TransferConfig("out", cars=CARS, arms=["unrepaired", "randomised"])
    assert diagnosis_jobs(lean, Path("scripts")) == []
    assert models(lean, Path("scripts")) == []
