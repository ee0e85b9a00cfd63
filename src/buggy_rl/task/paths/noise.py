"""Simplex noise of many seeds at once: the opensimplex library's, number for number, but sooner."""

from collections.abc import Sequence

import numpy as np
import opensimplex
from numpy.typing import NDArray
from opensimplex.constants import GRADIENTS2, NORM_CONSTANT2, SQUISH_CONSTANT2, STRETCH_CONSTANT2

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
