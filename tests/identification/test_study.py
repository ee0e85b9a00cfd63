import pytest

from buggy_rl.config import build, plain
from buggy_rl.identification.study import (
    DataConfig,
    RunConfig,
    StudyConfig,
    candidates,
    divide,
    file_name,
    model_runs,
)
from buggy_rl.models.training import TrainingConfig
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
        list(candidates(build(StudyConfig, [str(file)]), []))


def test_names_become_file_names_without_surprises():
    assert file_name("MLP, one step (raw)") == "mlp__one_step__raw"


def test_a_model_that_was_trained_on_a_judge_is_refused(tmp_path):
    from buggy_rl.models.factory import ModelConfig, make_model, save_model

    (tmp_path / "models").mkdir()
    model, training = ModelConfig(), plain(TrainingConfig())
    about = {"dt": 0.01, "drives": ["a", "b"], "training": training}
    save_model(make_model(model), model, tmp_path / "models" / "mlp.pt", about)
    file = tmp_path / "study.yaml"
    runs = "{MLP: {model: {kind: mlp}}}"
    file.write_text(f"output: {tmp_path}\ndata: {{recordings: [x]}}\nruns: {runs}\n")
    config = build(StudyConfig, [str(file)])
    assert next(candidates(config, ["c"])).name == "MLP"
    with pytest.raises(ValueError, match=r"was trained on \['b'\], which now judge"):
        next(candidates(config, ["b", "c"]))


def test_a_model_of_another_config_is_not_judged_under_its_name(tmp_path):
    from buggy_rl.models.factory import ModelConfig, make_model, save_model

    config = StudyConfig(output=str(tmp_path), runs={"MLP": RunConfig()})
    model, training = ModelConfig(), {**plain(TrainingConfig()), "epochs": 7}
    about = {"drives": ["a"], "dt": 0.01, "training": training}
    save_model(make_model(model), model, tmp_path / "models" / "mlp.pt", about)
    with pytest.raises(ValueError, match=r"training\.epochs was 7, now 60; train it anew"):
        next(candidates(config, ["c"]))


def test_only_an_existing_model_can_be_chosen(tmp_path):
    file = tmp_path / "study.yaml"
    file.write_text("output: o\ndata: {recordings: [x]}\nruns: {MLP: {model: {kind: mlp}}}\n")
    with pytest.raises(ValueError, match=r"only=\['MLPP'\]: the models are \['MLP'\]"):
        list(model_runs(build(StudyConfig, [str(file), "only=[MLPP]"])))
