"""Properties of every model."""

import pytest
import torch
from torch.testing import assert_close

from buggy_rl.simulators.learned import MODELS
from buggy_rl.simulators.learned.base import MARGIN, Ensemble
from buggy_rl.simulators.learned.factory import ModelConfig, load_model, make_model, save_model

KINDS = [*MODELS, "ensemble"]


def make(kind: str):
    torch.manual_seed(0)
    config = ModelConfig("mlp", members=3) if kind == "ensemble" else ModelConfig(kind)
    return make_model(config), config


@pytest.mark.parametrize("kind", KINDS)
def test_any_batch_shape_gives_the_same_rows(kind: str):
    model, _ = make(kind)
    history = torch.randn(3, 4, model.rows, 5)
    whole = model.change(history)
    assert whole.shape == (3, 4, 3)
    assert_close(model.change(history[1, 2]), whole[1, 2], atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_the_present_row_and_the_oldest_row_both_matter(kind: str):
    model, _ = make(kind)
    history = torch.randn(1, model.rows, 5, requires_grad=True)
    model.change(history).sum().backward()
    assert history.grad is not None
    assert history.grad[0, -1].abs().sum() > 0
    assert history.grad[0, getattr(model, "unused", 0)].abs().sum() > 0


@pytest.mark.parametrize("kind", KINDS)
def test_a_standing_car_without_drive_stands_still_whatever_the_steering(kind: str):
    model, _ = make(kind)
    history = torch.zeros(5, model.rows, 5)
    history[..., 3] = -1.0
    history[..., 4] = torch.linspace(-1, 1, 5)[:, None]
    assert model.change(history).abs().max() > 0, (
        "the bare network creeps, else there is nothing to constrain"
    )
    assert torch.equal(model(history), torch.zeros(5, 3))


@pytest.mark.parametrize("kind", KINDS)
def test_no_step_leaves_the_widened_training_range(kind: str):
    model, _ = make(kind)
    model.output_scale.fill_(50.0)
    following = model(torch.randn(200, model.rows, 5))
    width = (model.envelope.high - model.envelope.low)[:3]
    assert (following <= model.envelope.high[:3] + MARGIN * width + 1e-6).all()
    assert (following >= model.envelope.low[:3] - MARGIN * width - 1e-6).all()
    assert following.abs().max() > 1.0, "the clamp was reached"


@pytest.mark.parametrize("kind", KINDS)
def test_a_saved_model_predicts_the_same_after_loading(kind: str, tmp_path):
    model, config = make(kind)
    model.envelope.fit(torch.randn(500, 5))
    model.rest_throttle.fill_(-0.7)
    save_model(model, config, tmp_path / "model.pt", {"dt": 0.01})
    loaded, about = load_model(tmp_path / "model.pt")
    history = torch.randn(7, model.rows, 5)
    assert_close(loaded(history), model.eval()(history), atol=1e-6, rtol=1e-6)
    assert torch.equal(loaded.envelope.occupied, model.envelope.occupied)
    assert about == {"dt": 0.01}


def test_the_temporal_cnn_has_the_original_shape():
    model, _ = make("temporal_cnn")
    lengths = []
    for layer in model.convolutions:
        if isinstance(layer, torch.nn.Conv1d):
            layer.register_forward_hook(lambda _m, _i, out: lengths.append(tuple(out.shape[1:])))
    model.change(torch.randn(1, 20, 5))
    assert lengths == [(8, 8), (12, 3), (16, 1)]  # of 9 the original uses 8 too, but the oldest 8


def test_a_history_too_short_for_the_convolutions_is_refused():
    with pytest.raises(ValueError, match="at least 18 rows"):
        make_model(ModelConfig("temporal_cnn", options={"rows": 10}))


def test_an_ensemble_is_the_mean_of_its_members():
    model, _ = make("ensemble")
    assert isinstance(model, Ensemble)
    history = torch.randn(6, 1, 5)
    each = torch.stack([member.change(history) for member in model.members])
    assert_close(model.change(history), each.mean(0))


def test_unknown_models_and_options_are_refused_with_what_there_is():
    with pytest.raises(ValueError, match="temporal_cnn"):
        make_model(ModelConfig("perceptron"))
    with pytest.raises(ValueError, match="depth"):
        make_model(ModelConfig("mlp", options={"depth": 3}))


def test_a_file_that_is_no_model_is_refused(tmp_path):
    torch.save({"weights": {}}, tmp_path / "x.pt")
    with pytest.raises(ValueError, match=r"x\.pt was not written by"):
        load_model(tmp_path / "x.pt")
