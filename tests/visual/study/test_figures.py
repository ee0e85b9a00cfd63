"""Figures from made-up results: what is drawn, and what is skipped with a remedy."""

import numpy as np
import pytest

from buggy_rl.estimation.fit_study import DataConfig, RunConfig
from buggy_rl.estimation.open_loop import save_rollouts
from buggy_rl.simulators.learned.training import TrainingConfig
from buggy_rl.visual.study.figures import FIGURES, FiguresConfig, MissingError
from tests.visual.study import made
from tests.visual.study.made import straight

SAMPLE = ["data/sample/sample_00.csv", "data/sample/sample_01.csv", "data/sample/sample_02.csv"]


@pytest.fixture
def config(tmp_path):
    made.write(tmp_path)
    runs = {"MLP": RunConfig(preparations=["raw", "mirrored"]), "GRU": RunConfig()}
    return FiguresConfig(output=str(tmp_path), data=DataConfig(recordings=SAMPLE), runs=runs)


def panels(figure):
    return [axis for axis in figure.axes if axis.axison]


@pytest.mark.parametrize("name", ["driven", "signals", "bundles", "repair"])
def test_every_label_has_its_unit(config, name):
    figure = FIGURES[name](config)
    assert any(axis.get_xlabel() for axis in panels(figure))
    assert any(axis.get_ylabel() for axis in panels(figure))
    for axis in panels(figure):
        for label in (axis.get_xlabel(), axis.get_ylabel()):
            assert not label or "[" in label or label in ("share of the rows",) or "time" in label


def test_labels_are_differences_over_the_control_period(config):
    axes = FIGURES["signals"](config).axes
    raw, rate = axes[0].lines[0].get_ydata(), axes[1].lines[0].get_ydata()
    np.testing.assert_allclose(rate, np.diff(raw) / 0.01, rtol=1e-5)


def test_a_bundle_has_the_best_four_simulators(config, tmp_path):
    speeds = {f"off by {k}": straight(speed=1 + 0.1 * k) for k in (3, 1, 5, 2, 4)}
    save_rollouts(tmp_path / "rollouts.npz", ["a"] * 6, 0.01, straight(), speeds)
    figure = FIGURES["bundles"](config)
    titles = [axis.get_title() for axis in figure.axes if axis.get_title()]
    assert titles == ["off by 1", "off by 2", "off by 3", "off by 4"]


def test_a_bundle_of_one_second_ends_after_one_second(config):
    first = FIGURES["bundles"](config).axes[0]
    assert first.lines[0].get_xdata()[-1] == pytest.approx(1.0)  # at 1 m/s


def test_preparations_of_a_model_share_a_panel(config, tmp_path):
    for name in ("mlp__raw", "mlp__mirrored", "gru"):
        logs = tmp_path / "models" / name / "csv" / "scalars"
        logs.mkdir(parents=True)
        for metric in ("training_loss", "validation_loss"):
            (logs / f"{metric}.csv").write_text("1,0.5\n2,0.4\n")
    found = panels(FIGURES["training"](config))
    assert {axis.get_title(): len(axis.lines) for axis in found} == {"MLP": 4, "GRU": 2}
    assert TrainingConfig().preparation == "raw"


@pytest.mark.parametrize(
    ("name", "remedy"),
    [
        ("training", "scripts/train_models.py writes them"),
        ("bundles", "scripts/evaluate_models.py writes it"),
        ("learning", r"learning.runs.NAME=\[FOLDER\] of scripts/train_policy.py"),
        ("policies", "policies.policies.NAME=FILE"),
        ("repair", "scripts/study.py writes it"),
    ],
)
def test_what_is_not_there_is_named_with_the_command_that_makes_it(tmp_path, name, remedy):
    empty = FiguresConfig(output=str(tmp_path / "x"), data=DataConfig(recordings=SAMPLE))
    with pytest.raises(MissingError, match=remedy):
        FIGURES[name](empty)
