"""Figures, by their content."""

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
import torch
from matplotlib.collections import LineCollection

from buggy_rl.figures.policies import learning_figure, policies_figure
from buggy_rl.policies.evaluation.drives import DrivenTrack, Panel
from buggy_rl.policies.training.seeds import Curve


@pytest.fixture(autouse=True)
def _closed():
    yield
    plt.close("all")


def track(shift, waypoints):
    """Along a quarter circle, ever faster."""
    angle = torch.linspace(0.0, 1.5, 7)
    pose = torch.stack([torch.sin(angle), 1 - torch.cos(angle) + shift, angle], -1)
    velocity = torch.stack([angle, torch.zeros(7), torch.ones(7)], -1)
    return DrivenTrack(pose, velocity, waypoints, 0.123)


def panel(policy, place, course):
    waypoints = torch.tensor([[0.0, 0.0], [1.0, 1.0], [0.0, 2.0], [0.0, 0.0]])
    return Panel(policy, place, course, waypoints, track(0.1, 42.0), track(0.0, 40.0))


def drawn(figure):
    """The axes, without the colour scale."""
    return [axis for axis in figure.axes if axis.get_title()]


def test_policies_have_a_row_for_each_path_and_a_column_for_each_place():
    courses, places = ("lap", "infinity"), ("in its simulator", "on the reference car")
    every = [panel(p, w, c) for p in ("one", "two") for w in places for c in courses]
    figure = policies_figure(every)
    axes = drawn(figure)
    assert len(axes) == 8
    assert [a.get_title() for a in axes] == [
        f"{course}: 42 waypoints, 12.3 cm off" for course in courses for _ in range(4)
    ]
    headings = [a.texts[0].get_text() for a in axes[:4]]
    assert headings == [f"{policy}, {place}" for policy in ("one", "two") for place in places]
    assert axes[0].get_ylabel() == "y [m]"
    assert axes[-1].get_xlabel() == "x [m]"
    assert all(a.get_aspect() == 1.0 for a in axes)


def test_the_line_driven_is_coloured_by_speed_beside_pure_pursuits():
    figure = policies_figure([panel("one", "here", "lap"), panel("one", "there", "lap")])
    for axis in drawn(figure):
        (line,) = [c for c in axis.collections if isinstance(c, LineCollection)]
        colour = line.get_array()
        assert colour is not None
        np.testing.assert_allclose(colour, track(0.1, 42.0).velocity[1:, 0])
        np.testing.assert_allclose(line.get_segments()[0][0], [0.0, 0.1], atol=1e-6)
        compared = axis.lines[1].get_xydata()
        np.testing.assert_allclose(compared, track(0.0, 40.0).pose[:, :2])
    limits = {axis.get_xlim() + axis.get_ylim() for axis in drawn(figure)}
    assert len(limits) == 1  # one path is as large in every column


def test_learning_curves_are_a_mean_in_a_band_with_the_score_to_beat():
    steps = [1_000_000, 2_000_000]
    band = pd.DataFrame(
        {"mean": [5.0, 8.0], "low": [4.0, 7.0], "high": [6.0, 10.0]}, pd.Index(steps)
    )
    every = [
        Curve("a", "validation_waypoints", band, 3, 9.5),
        Curve("b", "waypoints", band, 1, None),
    ]
    training, validation = learning_figure(every).axes
    mean, score = validation.lines
    assert mean.get_xydata().tolist() == [[1.0, 5.0], [2.0, 8.0]]
    assert set(score.get_ydata()) == {9.5}
    assert score.get_linestyle() == "--"
    assert mean.get_color() == score.get_color() != training.lines[0].get_color()
    corners = validation.collections[0].get_paths()[0].vertices
    assert (corners[:, 1].min(), corners[:, 1].max()) == (4.0, 10.0)
    assert [text.get_text() for text in validation.get_legend().get_texts()] == [
        "a, 3 seeds", "a, pure pursuit",
    ]  # fmt: skip
    assert len(training.lines) == 1
