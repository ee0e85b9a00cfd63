"""Arrays of NumPy or PyTorch, for physics that is written once for both.

Functions are those of the Python array API standard, through array-api-compat; indexing and
assignment to slices are beyond the standard and the same in both.
"""

import math
from collections.abc import Sequence
from typing import Any

from array_api_compat import array_namespace, device, is_numpy_namespace

Array = Any
"""A NumPy array or a PyTorch tensor; one function gets only one of the two."""


def array_like(values: Any, like: Array) -> Array:
    """Numbers as an array of the kind, precision and device of `like`."""
    return array_namespace(like).asarray(values, dtype=like.dtype, device=device(like))


def column_like(values: Sequence[Any], like: Array) -> Array:
    """Numbers, or arrays of one, as an array [k, 1] of the kind, precision and device of `like`."""
    return stacked([array_like(v, like) if isinstance(v, float) else v for v in values])[:, None]


def indices_like(values: Any, like: Array) -> Array:
    """Whole numbers as an array of the kind and device of `like`."""
    xp = array_namespace(like)
    return xp.asarray(values, dtype=xp.int64, device=device(like))


def on_gpu(values: Array) -> bool:
    """Whether a question about them waits for all work of a GPU."""
    return str(device(values)) != "cpu"


def angle_of(y: Array, x: Array) -> Array:
    """atan2(y, x); PyTorch's own rounds it by an array's place in the batch."""
    xp = array_namespace(x)
    if is_numpy_namespace(xp):
        return xp.atan2(y, x)
    half = 2.0 * xp.atan(y / (xp.sqrt(x * x + y * y) + xp.abs(x)))
    return xp.where(x >= 0.0, half, xp.where(y < 0.0, -math.pi, math.pi) - half)


def copied(values: Array) -> Array:
    """A copy that may be written."""
    return array_namespace(values).asarray(values, copy=True)


def stacked(rows: Sequence[Array], axis: int = 0) -> Array:
    """Arrays of shapes that broadcast, stacked along a new axis."""
    xp = array_namespace(*rows)
    return xp.stack(xp.broadcast_arrays(*rows), axis=axis)


def solve3(a: Sequence[Sequence[Array]], b: Sequence[Array]) -> tuple[Array, Array, Array]:
    """Solves n systems of three equations by Cramer's rule; a[i][j], b[i] are [n]."""
    c00 = a[1][1] * a[2][2] - a[1][2] * a[2][1]
    c01 = a[1][2] * a[2][0] - a[1][0] * a[2][2]
    c02 = a[1][0] * a[2][1] - a[1][1] * a[2][0]
    scale = 1.0 / (a[0][0] * c00 + a[0][1] * c01 + a[0][2] * c02)
    d0 = a[0][2] * a[2][1] - a[0][1] * a[2][2]
    d1 = a[0][0] * a[2][2] - a[0][2] * a[2][0]
    d2 = a[0][1] * a[2][0] - a[0][0] * a[2][1]
    e0 = a[0][1] * a[1][2] - a[0][2] * a[1][1]
    e1 = a[0][2] * a[1][0] - a[0][0] * a[1][2]
    e2 = a[0][0] * a[1][1] - a[0][1] * a[1][0]
    return (
        (c00 * b[0] + d0 * b[1] + e0 * b[2]) * scale,
        (c01 * b[0] + d1 * b[1] + e1 * b[2]) * scale,
        (c02 * b[0] + d2 * b[1] + e2 * b[2]) * scale,
    )
