from dataclasses import replace

import pytest
import yaml

from buggy_rl.core.config import build, plain_values
from buggy_rl.estimation.fit_study import (
    DataConfig,
    RunConfig,
    StudyConfig,
    StudyDrives,
    compared_simulators,
    divide,
    file_name,
    fit_question,
    model_runs,
    refuse_other_drives,
)
from buggy_rl.simulators.learned.training import TrainingConfig
from tests.drives import counting_drive


def drives(names: str):
    return [counting_drive(name, 5) for name in names]


def test_named_drives_go_where_they_are_named():
    config = DataConfig(recordings=[], held_out=["b"], validation=["d"], leave_out=["a"])
    divided = divide(drives("abcde"), config)
    assert [r.name for r in divided.held_out] == ["b"]
    assert [r.name for r in divided.validation] == ["d"]
    assert [r.name for r in divided.training] == ["c", "e"]


def test_without_names_every_drive_has_exactly_one_use():
    divided = divide(drives("abcdefghij"), DataConfig(recordings=[]))
    parts = [[r.name for r in part] for part in vars(divided).values()]
    assert sorted(name for part in parts for name in part) == list("abcdefghij")
    assert len(divided.held_out) == 2
    assert len(divided.validation) == 1


def test_two_drives_are_too_few_and_the_message_says_what_to_do():
    with pytest.raises(ValueError, match="record more"):
        divide(drives("ab"), DataConfig(recordings=[]))


def test_each_preparation_is_a_row_of_its_own(tmp_path):
    file = tmp_path / "study.yaml"
    file.write_text(
        "output: out\ndata: {recordings: [x]}\n"
        "runs:\n  MLP: {preparations: [raw, mirrored]}\n  GRU: {model: {kind: gru}}\n"
    )
    runs = list(model_runs(build(StudyConfig, [str(file)])))
    assert [name for name, _, _ in runs] == ["MLP, raw", "MLP, mirrored", "GRU"]
    assert [training.preparation for _, _, training in runs] == ["raw", "mirrored", "raw"]


def test_comparing_before_training_says_what_to_run(tmp_path):
    file = tmp_path / "study.yaml"
    file.write_text(
        f"output: {tmp_path}\ndata: {{recordings: [x]}}\nruns: {{MLP: {{model: {{kind: mlp}}}}}}\n"
    )
    with pytest.raises(ValueError, match=r"scripts/train_models\.py"):
        list(compared_simulators(build(StudyConfig, [str(file)]), []))


def test_names_become_file_names_without_surprises():
    assert file_name("MLP, one step (raw)") == "mlp__one_step__raw"


def test_a_model_that_was_trained_on_a_judge_is_refused(tmp_path):
    from buggy_rl.simulators.learned.factory import ModelConfig, make_model, save_model

    (tmp_path / "models").mkdir()
    model, training = ModelConfig(), plain_values(TrainingConfig())
    about = {"dt": 0.01, "drives": ["a", "b"], "training": training}
    save_model(make_model(model), model, tmp_path / "models" / "mlp.pt", about)
    file = tmp_path / "study.yaml"
    runs = "{MLP: {model: {kind: mlp}}}"
    file.write_text(f"output: {tmp_path}\ndata: {{recordings: [x]}}\nruns: {runs}\n")
    config = build(StudyConfig, [str(file)])
    assert next(compared_simulators(config, ["c"])).name == "MLP"
    with pytest.raises(ValueError, match=r"was trained on \['b'\], which now judge"):
        next(compared_simulators(config, ["b", "c"]))


def test_a_model_of_another_config_is_not_judged_under_its_name(tmp_path):
    from buggy_rl.simulators.learned.factory import ModelConfig, make_model, save_model

    config = StudyConfig(output=str(tmp_path), runs={"MLP": RunConfig()})
    model, training = ModelConfig(), {**plain_values(TrainingConfig()), "epochs": 7}
    about = {"drives": ["a"], "dt": 0.01, "training": training}
    save_model(make_model(model), model, tmp_path / "models" / "mlp.pt", about)
    with pytest.raises(ValueError, match=r"training\.epochs was 7, now 60; train it anew"):
        next(compared_simulators(config, ["c"]))


def test_only_an_existing_model_can_be_chosen(tmp_path):
    file = tmp_path / "study.yaml"
    file.write_text("output: o\ndata: {recordings: [x]}\nruns: {MLP: {model: {kind: mlp}}}\n")
    with pytest.raises(ValueError, match=r"only=\['MLPP'\]: the models are \['MLP'\]"):
        list(model_runs(build(StudyConfig, [str(file), "only=[MLPP]"])))


def other_content(drive):
    """A drive of the same name in which the car went the other way."""
    return replace(drive, data=drive.data.clone().apply(lambda value: -value))


def test_a_fit_of_other_drives_of_the_same_names_is_not_judged(tmp_path):
    config = StudyConfig(output=str(tmp_path))
    a, b, c = drives("abc")
    given = StudyDrives([a], [b], [c])
    content = {"engine": "mujoco", "_question": fit_question(config, given)}
    fitted = tmp_path / "mujoco_fitted.yaml"
    fitted.write_text(yaml.safe_dump(content))
    refuse_other_drives(config, given)
    refuse_other_drives(config, replace(given, held_out=[other_content(c)]))  # not fitted to
    with pytest.raises(ValueError, match="recording a has other content now; fit it anew"):
        refuse_other_drives(config, replace(given, training=[other_content(a)]))
    fewer = replace(config, fit=replace(config.fit, windows=7))
    with pytest.raises(ValueError, match=r"fit\.windows was 150, now 7; fit it anew"):
        refuse_other_drives(fewer, given)
    fitted.write_text(yaml.safe_dump({"engine": "mujoco"}))
    with pytest.raises(ValueError, match="does not say what it was made from"):
        refuse_other_drives(config, given)


@pytest.mark.parametrize("use", ["training", "validation"])
def test_a_model_of_other_drives_of_the_same_names_is_not_judged(tmp_path, use):
    from buggy_rl.simulators.learned.factory import ModelConfig, make_model, save_model
    from buggy_rl.simulators.learned.training import model_question

    config = StudyConfig(output=str(tmp_path), runs={"MLP": RunConfig()})
    a, b, c = drives("abc")
    given, model, training = StudyDrives([a], [b], [c]), ModelConfig(), TrainingConfig()
    about = {"drives": ["a", "b"], "dt": 0.01, "training": plain_values(training)}
    about["question"] = model_question(model, training, [a], [b])
    (tmp_path / "models").mkdir()
    save_model(make_model(model), model, tmp_path / "models" / "mlp.pt", about)
    refuse_other_drives(config, given)
    refuse_other_drives(config, StudyDrives([b], [a], [*drives("d"), c]))  # other uses of the same
    [drive] = getattr(given, use)
    changed = replace(given, **{use: [other_content(drive)]})
    with pytest.raises(ValueError, match=f"recording {drive.name} has other content now; train"):
        refuse_other_drives(config, changed)
