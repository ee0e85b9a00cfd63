"""Paths as points: straights and arcs, points of a file, and random paths from simplex noise.

Noise in x and y, as in the original study (section 5.2.1; its scale of 10 m is a room of 20 m).
Such noise has cusps that no car can follow, so a point with a bounded turning radius chases it,
and its track is the path.
"""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import opensimplex
import pandas as pd
from numpy.typing import NDArray
from opensimplex.constants import GRADIENTS2, NORM_CONSTANT2, SQUISH_CONSTANT2, STRETCH_CONSTANT2
from scipy.interpolate import CubicSpline

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
        given = ", ".join(str(value) for value in table[["x", "y"]].iloc[row])
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


RANGE_SQUARED = 2.0  # of a lattice point's influence, in units of noise
NEAR = ((1, 0), (0, 1))  # lattice points that reach every place of their cell
CORNERS = ((0, 0), (1, 1))  # the nearer one is added first
FAR = ((1, -1), (-1, 1), (2, 0), (0, 2))  # those that reach into the cell from outside


def simplex_noise(seeds: Sequence[int], x: NDArray, y: NDArray) -> NDArray:
    """Noise at places of a plane that is different for each seed.

    n(p) = sum_i max(0, 2 - |d_i|^2)^4 g_i . d_i / N,  d_i from lattice point i to p

    over the lattice of equilateral triangles, with a gradient g_i of eight that the seed deals out.
    The library goes from place to place in Python, which takes 20 times as long.

    Args:
        seeds: [P].
        x: Places [P, ...].
        y: Likewise.

    Returns:
        [P, ...] within -1..1, to the last bit what `opensimplex.OpenSimplex(seed).noise2(x, y)` is.
    """
    deal = np.stack([opensimplex.OpenSimplex(seed)._perm for seed in seeds])  # (P, 256)
    seed = np.arange(len(deal)).reshape(-1, *[1] * (x.ndim - 1))
    stretch = (x + y) * STRETCH_CONSTANT2
    cell_x, cell_y = np.floor(x + stretch).astype(int), np.floor(y + stretch).astype(int)
    squish = (cell_x + cell_y) * SQUISH_CONSTANT2
    dx, dy = x - (cell_x + squish), y - (cell_y + squish)

    def part(i: int, j: int) -> NDArray:
        px, py = (d - k - (i + j) * SQUISH_CONSTANT2 for d, k in ((dx, i), (dy, j)))
        weight = np.maximum(RANGE_SQUARED - px * px - py * py, 0.0) ** 2
        column = deal[seed, (cell_x + i) & 0xFF]
        gradient = deal[seed, (column + cell_y + j) & 0xFF] & 0x0E  # its first number's place
        along = GRADIENTS2[gradient] * px + GRADIENTS2[gradient + 1] * py
        return weight * weight * along

    upper = (x + stretch - cell_x) + (y + stretch - cell_y) > 1
    low, high = (part(*corner) for corner in CORNERS)
    total = part(*NEAR[0]) + part(*NEAR[1])
    total = total + np.where(upper, high, low) + np.where(upper, low, high)
    for corner in FAR:
        total = total + part(*corner)
    return total / NORM_CONSTANT2


SAMPLES = 8  # of noise in a unit; a spline through them is within 0.2 % of the amplitude
METRES_A_UNIT = 1.14  # of path in a unit of noise of 1 m amplitude; mean of 200, measured
NOISE_RESERVE = 1.6  # more noise than the path is long: lengths vary, and the chase cuts corners
CHASE_STEPS = 4  # a spacing
LINES_APART = 50.0  # units of noise: x and y have nothing in common
LOOK_AHEAD = 2.0  # radii between chaser and chased; a tighter hold would overshoot


def simplex_paths(
    seeds: Sequence[int],
    waypoints: int,
    spacing: float,
    room: float,
    radius: float,
    straight_spacing: float = 0.0,
) -> NDArray:
    """One random path a seed, from the origin along x.

    Args:
        seeds: Of the noise.
        waypoints: Of each path.
        spacing: Between them along the path [m].
        straight_spacing: Between them where it is straight [m]; 0 for `spacing`.
        room: Side of the square that the noise can fill [m].
        radius: Tightest turn [m]; 0 leaves the noise as it is.

    Returns:
        [P, waypoints, 2] x, y [m].

    Raises:
        ValueError: The noise was too short, which would be a fault in this module.
    """
    amplitude, step, wider = room / 2, spacing / CHASE_STEPS, straight_spacing > 0
    rows = math.ceil(waypoints * CHASE_STEPS * (straight_spacing / spacing if wider else 1.0))
    units = math.ceil(NOISE_RESERVE * rows * step / (METRES_A_UNIT * amplitude)) + 1
    place = np.arange(units * SAMPLES + 1) / SAMPLES
    noise = _noise(seeds, place)  # (P, 2, units * SAMPLES + 1)
    fine = np.arange(0, units, step / (2 * METRES_A_UNIT * amplitude))
    curve = amplitude * CubicSpline(place, noise, axis=-1)(fine)  # (P, 2, M)
    evenly = [resampled(path.T, step) for path in curve]
    track = np.stack([path[: min(map(len, evenly))] for path in evenly])  # (P, M', 2)
    if radius > 0:
        track = pursue(track, step, radius, rows)
    if track.shape[1] < rows:
        raise ValueError(f"a random path ended at {track.shape[1]} of {rows}: raise NOISE_RESERVE")
    if not wider:
        return from_origin(track[:, :rows:CHASE_STEPS])
    turn = smoothed_curvature(track, step) * (radius or spacing)
    apart = straight_spacing + (spacing - straight_spacing) * np.minimum(turn, 1.0)  # (P, M)
    count = np.cumsum(step / apart, axis=1) - step / apart[:, :1]
    at = np.stack([np.searchsorted(row, np.arange(waypoints)) for row in count])
    return from_origin(np.take_along_axis(track, at[..., None], 1))


def smoothed_curvature(track: NDArray, step: float) -> NDArray:
    """Absolute curvature [P, M] over a spacing about each point of tracks [P, M, 2] [1/m].

    A chaser turns by full lock and back, so that from step to step there is none.
    """
    before, behind = (np.roll(track, by, axis=1) for by in (CHASE_STEPS, -CHASE_STEPS))
    before[:, :CHASE_STEPS], behind[:, -CHASE_STEPS:] = track[:, :1], track[:, -1:]
    a, b = track - before, behind - track
    turn = np.arctan2(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0], (a * b).sum(-1))
    return np.abs(turn) / (CHASE_STEPS * step)


def _noise(seeds: Sequence[int], place: NDArray) -> NDArray:
    """Simplex noise [P, 2, N] along two lines, for x and y."""
    # Noise is zero in the corners of its lattice: begin anywhere, or all paths begin alike.
    begin = np.stack([np.random.default_rng(seed).uniform(0.0, 1.0, 2) for seed in seeds])
    along = np.repeat(begin[:, :1, None] + place, 2, axis=1)  # (P, 2, N)
    lines = begin[:, 1:] + np.array([0.0, LINES_APART])  # (P, 2)
    return simplex_noise(seeds, along, np.broadcast_to(lines[..., None], along.shape))


def pursue(target: NDArray, step: float, radius: float, rows: int) -> NDArray:
    """Track [P, rows, 2] of points that chase targets [P, M, 2] with a bounded turning radius.

    Turns towards the target by at most step / radius a step; the target keeps its distance.
    Ends early when a target does.
    """
    position = target[:, 0].copy()
    heading = np.arctan2(*(target[:, 1] - target[:, 0]).T[::-1])
    path, ahead = np.arange(len(target)), np.zeros(len(target), int)
    track = np.empty((len(target), rows, 2))
    for row in range(rows):
        track[:, row] = position
        for _ in range(2):  # a target that comes towards its chaser has to get past it
            ahead += np.hypot(*(target[path, ahead] - position).T) < LOOK_AHEAD * radius
        if ahead.max() >= target.shape[1] - 2:
            return track[:, :row]
        bearing = np.arctan2(*(target[path, ahead] - position).T[::-1])
        turn = (bearing - heading + math.pi) % (2 * math.pi) - math.pi
        heading += np.clip(turn, -step / radius, step / radius)
        position += step * np.stack([np.cos(heading), np.sin(heading)], -1)
    return track
