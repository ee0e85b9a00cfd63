"""Random paths from simplex noise.

Noise in x and y, as in the original study (section 5.2.1; its scale of 10 m is a room of 20 m).
Such noise has cusps that no car can follow, so a point with a bounded turning radius chases it,
and its track is the path.
"""

import math
from collections.abc import Sequence

import numpy as np
import opensimplex
from numpy.typing import NDArray
from opensimplex.constants import GRADIENTS2, NORM_CONSTANT2, SQUISH_CONSTANT2, STRETCH_CONSTANT2
from scipy.interpolate import CubicSpline

from buggy_rl.task.paths.shapes import from_origin, resampled

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
    seeds: Sequence[int], waypoints: int, spacing: float, room: float, radius: float
) -> NDArray:
    """One random path a seed, from the origin along x.

    Args:
        seeds: Of the noise.
        waypoints: Of each path.
        spacing: Between them along the path [m].
        room: Side of the square that the noise can fill [m].
        radius: Tightest turn [m]; 0 leaves the noise as it is.

    Returns:
        [P, waypoints, 2] x, y [m].

    Raises:
        ValueError: The noise was too short, which would be a fault in this module.
    """
    amplitude, step, rows = room / 2, spacing / CHASE_STEPS, waypoints * CHASE_STEPS
    units = math.ceil(NOISE_RESERVE * waypoints * spacing / (METRES_A_UNIT * amplitude)) + 1
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
    return from_origin(track[:, :rows:CHASE_STEPS])


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
