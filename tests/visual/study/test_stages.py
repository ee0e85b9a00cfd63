"""The plan of a study: what is run, in which order, and what is not run again."""

from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from buggy_rl.core.config import build, from_plain
from buggy_rl.estimation.fit_study import DataConfig, RunConfig, StudyConfig
from buggy_rl.jobs import run_jobs
from buggy_rl.simulators.learned.training import TrainingConfig
from buggy_rl.visual.study.stages import PolicyStage, StudyPlan, WholeStudyConfig
from tests.visual.study import made

SCRIPTS = Path(__file__).parents[3] / "scripts"


@pytest.fixture
def config(tmp_path):
    runs = {"MLP": RunConfig(), "GRU": RunConfig()}
    data = DataConfig(recordings=["data/sample"])
    return WholeStudyConfig(output=str(tmp_path / "study"), data=data, runs=runs)


def plan(config, scripts=SCRIPTS):
    made.table(Path(config.output), {"MLP": 0.2, "GRU": 0.1, "mujoco, fitted": 0.05})
    return StudyPlan(config, ["held_out.csv"], scripts)


def commands(config):
    return {s.job.name: s.job.command[1:] for wave in plan(config).waves() for s in wave}


def test_every_stage_is_a_script_of_the_project(config):
    for wave in plan(config).waves():
        for stage in wave:
            assert Path(stage.job.command[0]).is_file(), stage.job.command


def test_policies_are_trained_in_the_best_learned_model_and_in_the_fitted_simulator(config):
    found = commands(config)
    assert f"engine.simulator={config.output}/models/gru.pt" in found["policy_learned_0"]
    assert f"engine.simulator={config.output}/mujoco_fitted.yaml" in found["policy_fitted_0"]


def test_the_diagnosis_is_of_the_fitted_simulator_on_held_out_recordings_alone(config):
    arguments = commands(config)["diagnosis"]
    assert f"simulator={config.output}/mujoco_fitted.yaml" in arguments
    assert "recordings=[held_out.csv]" in arguments


def test_the_simulator_as_it_comes_may_be_diagnosed_instead(config):
    config = replace(config, car="dart", fit_simulator="single_track")
    assert "car=dart" in commands(config)["diagnosis"]
    found = commands(replace(config, diagnosed="shipped"))["diagnosis"]
    assert "simulator=single_track" in found
    assert "car=dart" in found


@pytest.mark.parametrize("name", ["dart", "frictionmaps"])
def test_recordings_of_others_are_studied_by_one_short_config(name):
    file = SCRIPTS.parent / "configs" / f"{name}.yaml"
    assert len(file.read_text().splitlines()) < 30
    config = build(WholeStudyConfig, [str(file)])
    assert config.diagnosed == "shipped"
    assert not config.policy.seeds
    assert config.of_simulators.car == name


def test_without_seeds_no_policy_is_trained_or_driven(config):
    found = commands(replace(config, policy=PolicyStage(seeds=[])))
    assert not [name for name in found if "polic" in name]


def test_without_a_learned_model_the_remedy_is_named(config):
    made_plan = plan(config)
    made.table(Path(config.output), {"mujoco, fitted": 0.05})
    with pytest.raises(ValueError, match="no learned model: name some under runs"):
        made_plan.best_model()


def test_the_scripts_get_the_config_of_the_study_alone(config):
    plan(config).write()
    content = yaml.safe_load((Path(config.output) / "study.yaml").read_text())
    assert from_plain(StudyConfig, content, "study.yaml").runs.keys() == config.runs.keys()
    assert "policy" not in content


def test_the_repaired_simulator_is_compared_with_the_fitted_one_alone(config):
    plan(config).write()
    content = yaml.safe_load((Path(config.output) / "repair.yaml").read_text())
    repair = from_plain(StudyConfig, content, "repair.yaml")
    assert list(repair.simulators) == ["fitted", "repaired"]
    assert (repair.runs, repair.data) == ({}, config.data)


def test_the_shipped_config_is_a_study_of_its_own():
    options = ["data.recordings=[data/sample]", "output=x"]
    found = build(WholeStudyConfig, [str(SCRIPTS.parent / "configs" / "study.yaml"), *options])
    assert set(found.only) == set(found.runs)


def test_a_finished_stage_of_another_question_is_refused_with_what_differs(config):
    def first_wave(config, recordings):
        return next(iter(StudyPlan(config, ["held_out.csv"], SCRIPTS, recordings).waves()))

    read = {"content of recording one": "abc"}
    for stage in first_wave(config, read):
        stage.job.prepared(1)
    longer = replace(
        config, runs={**config.runs, "MLP": RunConfig(training=TrainingConfig(epochs=3))}
    )
    models, fit = first_wave(longer, read)
    with pytest.raises(ValueError, match=r"runs\.MLP\.training\.epochs was 60, now 3; use another"):
        _ = models.job.done
    assert not fit.job.done  # it does not depend on it
    models, fit = first_wave(config, {"content of recording one": "other"})
    for stage in (models, fit):
        with pytest.raises(ValueError, match="recording one has other content now"):
            _ = stage.job.done
    models, _ = first_wave(replace(config, windows=20, threads=2), read)
    assert not models.job.done


def test_a_finished_stage_is_not_run_again(tmp_path, config):
    scripts = tmp_path / "scripts"
    scripts.mkdir()
    counting = "import sys\nopen(sys.argv[1] + '.calls', 'a').write('x')\n"
    for name in ("train_models.py", "fit_mujoco.py"):
        (scripts / name).write_text(counting)
    for _ in range(2):
        made_plan = plan(config, scripts)
        made_plan.write()
        first = next(iter(made_plan.waves()))
        list(run_jobs([stage.job for stage in first], 1, poll=0.02))
    assert (Path(config.output) / "study.yaml.calls").read_text() == "xx"  # once for each script
