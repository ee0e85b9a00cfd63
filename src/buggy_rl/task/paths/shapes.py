"""Paths of straights and arcs, and lists of points."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

SAME_PLACE = 1e-6  # [m] a last row this near to the first closes a path


def along_arcs(pieces: Sequence[tuple[float, float]], spacing: float) -> NDArray:
    """Waypoints [W, 2] along straights and arcs that close, from the origin along x.

    A piece of length l and curvature k ends at a chord of l sinc(k l / 2) in the direction of
    half its turn, k l / 2.

    Args:
        pieces: (length [m], curvature [1/m], to the left positive) of each.
        spacing: Wished for [m]; the nearest that divides the whole length is taken.
    """
    total = sum(length for length, _ in pieces)
    count = round(total / spacing)
    at = np.arange(count) * total / count
    points, start, yaw, begin = np.empty((count, 2)), np.zeros(2), 0.0, 0.0
    for length, curvature in pieces:
        here = (at >= begin) & (at < begin + length)
        points[here] = start + _chord(at[here] - begin, curvature, yaw)
        start = start + _chord(np.array(length), curvature, yaw)
        yaw, begin = yaw + length * curvature, begin + length
    return points


def _chord(run: NDArray, curvature: float, yaw: float) -> NDArray:
    """Vectors from the start of an arc to its points after [*] m: [*, 2]."""
    half = run * curvature / 2
    chord = run * np.sinc(half / math.pi)
    return np.stack([chord * np.cos(yaw + half), chord * np.sin(yaw + half)], -1)


def read_points(file: Path, spacing: float) -> tuple[NDArray, bool]:
    """Waypoints [W, 2] of a file, from the origin along x, and whether they close.

    Raises:
        ValueError: It is no CSV with finite columns x, y; the message names file and row.
    """
    if not file.is_file():
        raise ValueError(f"there is no path file {str(file)!r}: name a CSV with columns x, y")
    table = pd.read_csv(file)
    if not {"x", "y"} <= set(table.columns):
        raise ValueError(f"{file} has columns {', '.join(table.columns)}: it needs x and y")
    numbers = table[["x", "y"]].apply(pd.to_numeric, errors="coerce").to_numpy(float)
    bad = np.flatnonzero(~np.isfinite(numbers).all(1))
    if len(bad):
        row = int(bad[0])
        given = ", ".join(str(value) for value in table.loc[row, ["x", "y"]])
        raise ValueError(f"{file}, row {row + 2}: x, y are {given}, not two finite numbers [m]")
    length = float(np.hypot(*np.diff(numbers, axis=0).T).sum())
    if len(numbers) < 3 or length < 2 * spacing:
        raise ValueError(
            f"{file} is {length:.3g} m long in {len(numbers)} rows: a path needs 3 rows and at "
            f"least two spacings, {2 * spacing:.3g} m"
        )
    closed = bool(np.hypot(*(numbers[0] - numbers[-1])) < SAME_PLACE)
    if closed:
        spacing = length / round(length / spacing)
    points = resampled(numbers, spacing)
    return from_origin(points[:-1] if closed else points), closed


def resampled(points: NDArray, step: float) -> NDArray:
    """Points along a polyline [M, 2], `step` [m] apart, from its first on."""
    run = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    at = np.arange(int(run[-1] / step + 1e-6) + 1) * step
    return np.stack([np.interp(at, run, points[:, axis]) for axis in (0, 1)], -1)


def from_origin(points: NDArray) -> NDArray:
    """Paths [*, W, 2], each moved and turned so that it leaves the origin along x."""
    own = points - points[..., :1, :]
    first = own[..., 1:2, :]
    cos, sin = np.moveaxis(first / np.hypot(first[..., :1], first[..., 1:]), -1, 0)
    x, y = own[..., 0], own[..., 1]
    return np.stack([cos * x + sin * y, cos * y - sin * x], -1)
