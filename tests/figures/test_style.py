"""The house style: colours that the colour-blind can tell apart, files in both formats."""

from itertools import combinations

import numpy as np
import pytest

from buggy_rl.figures.style import COLOURS, write_figure

# Machado, Oliveira & Fernandes 2009, severity 1.0, on linear sRGB.
SIGHT = {
    "normal": np.eye(3),
    "protanopia": np.array(
        [
            [0.152286, 1.052583, -0.204868],
            [0.114503, 0.786281, 0.099216],
            [-0.003882, -0.048116, 1.051998],
        ]
    ),
    "deuteranopia": np.array(
        [
            [0.367322, 0.860646, -0.227968],
            [0.280085, 0.672501, 0.047413],
            [-0.011820, 0.042940, 0.968881],
        ]
    ),
}
TO_XYZ = np.array(
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
)  # sRGB, IEC 61966-2-1
WHITE = np.array([0.9505, 1.0, 1.089])


def seen(colour, sight):
    """L*, a*, b* of #rrggbb."""
    part = np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)])
    linear = np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)
    xyz = TO_XYZ @ np.clip(SIGHT[sight] @ linear, 0, 1) / WHITE
    root = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.array([116 * root[1] - 16, 500 * (root[0] - root[1]), 200 * (root[1] - root[2])])


def closest(colours, sight):
    return min(np.linalg.norm(seen(a, sight) - seen(b, sight)) for a, b in combinations(colours, 2))


@pytest.mark.parametrize("sight", SIGHT)
def test_any_two_colours_can_be_told_apart(sight):
    assert closest(COLOURS, sight) > 15  # 2 is just noticeable side by side


def test_red_and_green_of_equal_lightness_could_not():
    assert closest(("#b05a5a", "#7a7a3c"), "deuteranopia") < 15


def test_a_figure_is_written_as_svg_and_png(tmp_path):
    from matplotlib.figure import Figure

    files = write_figure(Figure(), tmp_path / "new" / "v1.2")
    assert [file.name for file in files] == ["v1.2.svg", "v1.2.png"]
    assert all(file.stat().st_size > 100 for file in files)
