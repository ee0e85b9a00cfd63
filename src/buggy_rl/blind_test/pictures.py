"""Pictures of a score."""

from collections.abc import Mapping, Sequence

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Picture

from buggy_rl.blind_test.score import Row, Score
from buggy_rl.blind_test.statistics import Figure
from buggy_rl.viz.style import COLOURS, FAINT, tidy

GOOD, BAD = COLOURS[1], COLOURS[0]


def pictures(score: Score) -> dict[str, Picture]:
    """All of them, by the end of their file's name; those without a case are left out."""
    found = {"figures": targets(score.rows), "classes": classes(score.breakdown)}
    if score.calibration:
        found["confidence"] = confidence(score)
    if score.confusion:
        found["confusion"] = confusion(score.confusion)
    return found


def targets(rows: Sequence[Row]) -> Picture:
    """Every share with its interval, and the target where there is one."""
    shown = [row for row in rows if row.figure.count and row.percent and row.figure.value <= 1.5]
    picture, axis = plt.subplots(figsize=(8.5, 0.26 * len(shown) + 1), constrained_layout=True)
    for place, row in enumerate(reversed(shown)):
        colour = FAINT if row.met is None else GOOD if row.met else BAD
        _interval(axis, row.figure, place, colour)
        if row.target is not None:
            axis.plot(100 * row.target, place, "|", color="black", ms=13, mew=1.5)
    labels = [row.name.replace("  ", "– ") for row in reversed(shown)]
    axis.set_yticks(range(len(shown)), labels, fontsize=8)
    axis.set_ylim(-0.7, len(shown) - 0.3)
    axis.set_xlabel("% of the cases, with 95 % intervals; | is the target")
    tidy(axis)
    return picture


def classes(breakdown: Mapping[str, Mapping[str, Figure]]) -> Picture:
    """Share of right first names of single effects, class by class."""
    shown = {name: rows for name, rows in breakdown.items() if rows}
    wide = "effect"
    others = [name for name in shown if name != wide]
    picture = plt.figure(figsize=(11, 9), constrained_layout=True)
    if not shown:
        return picture
    heights = [max(2, len(shown[name])) for name in others]
    grid = picture.add_gridspec(len(others), 2, height_ratios=heights)
    _bars(picture.add_subplot(grid[:, 0]), wide, shown[wide])
    for place, name in enumerate(others):
        _bars(picture.add_subplot(grid[place, 1]), name, shown[name])
    return picture


def confidence(score: Score) -> Picture:
    """How often a claim of some confidence is right, and what is gained by being choosy."""
    picture, (left, right) = plt.subplots(1, 2, figsize=(9, 4), constrained_layout=True)
    said, right_share, count = zip(*score.calibration, strict=True)
    left.plot([0, 1], [0, 1], color=FAINT, lw=1)
    left.scatter(said, right_share, s=[12 + 6 * n for n in count], color=GOOD, alpha=0.8)
    left.set_xlabel("confidence said")
    left.set_ylabel("share that is right")
    answered, accurate = zip(*score.coverage, strict=True)
    right.step(answered, accurate, where="post", color=GOOD)
    right.set_xlabel("share answered, the surest first")
    right.set_ylabel("share of those that is right")
    for axis in (left, right):
        axis.set(xlim=(-0.02, 1.02), ylim=(-0.02, 1.04))
        tidy(axis)
    return picture


def confusion(counts: Mapping[str, Mapping[str, int]]) -> Picture:
    """What was true, downwards, against what was said first."""
    true = list(counts)
    extra = sorted({said for row in counts.values() for said in row} - set(true))
    said = [*true, *extra]
    table = np.array([[counts[t].get(s, 0) for s in said] for t in true], dtype=float)
    share = table / table.sum(1, keepdims=True)
    size = (0.26 * len(said) + 3, 0.26 * len(true) + 2.5)
    picture, axis = plt.subplots(figsize=size, constrained_layout=True)
    axis.imshow(share, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    for (row, column), count in np.ndenumerate(table):
        if count:
            colour = "white" if share[row, column] > 0.5 else "black"
            axis.text(
                column, row, f"{count:.0f}", ha="center", va="center", color=colour, fontsize=7
            )
    axis.set_xticks(range(len(said)), said, rotation=90, fontsize=7)
    axis.set_yticks(range(len(true)), true, fontsize=7)
    axis.set_xlabel("said first")
    axis.set_ylabel("concealed")
    return picture


def _bars(axis: Axes, name: str, rows: Mapping[str, Figure]) -> None:
    for place, figure in enumerate(reversed(list(rows.values()))):
        _interval(axis, figure, place, GOOD)
    labels = [f"{label} ({figure.count})" for label, figure in rows.items()]
    axis.set_yticks(range(len(rows)), labels[::-1], fontsize=7)
    axis.set_title(f"first name right, by {name} [%]", fontsize=9, loc="left")
    axis.set(xlim=(-3, 103), ylim=(-0.7, len(rows) - 0.3))
    axis.tick_params(axis="x", labelsize=7)
    tidy(axis)


def _interval(axis: Axes, figure: Figure, place: int, colour: str) -> None:
    low, value, high = (100 * v for v in (figure.low, figure.value, figure.high))
    axis.plot([low, high], [place, place], color=colour, lw=3, alpha=0.4)
    axis.plot(value, place, "o", color=colour, ms=5)
