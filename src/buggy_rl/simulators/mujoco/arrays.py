"""Arrays of NumPy or PyTorch, for physics that is written once for both.

Functions are those of the Python array API standard, through array-api-compat; indexing and
assignment to slices are beyond the standard and the same in both.
"""

from collections.abc import Sequence
from typing import Any

from array_api_compat import array_namespace, device

Array = Any
"""A NumPy array or a PyTorch tensor; one function gets only one of the two."""


def array_like(values: Any, like: Array) -> Array:
    """Numbers as an array of the kind, precision and device of `like`."""
    return array_namespace(like).asarray(values, dtype=like.dtype, device=device(like))


def indices_like(values: Any, like: Array) -> Array:
    """Whole numbers as an array of the kind and device of `like`."""
    xp = array_namespace(like)
    return xp.asarray(values, dtype=xp.int64, device=device(like))


def copied(values: Array) -> Array:
    """A copy that may be written."""
    return array_namespace(values).asarray(values, copy=True)


def stacked(rows: Sequence[Array], axis: int = 0) -> Array:
    """Arrays of shapes that broadcast, stacked along a new axis."""
    xp = array_namespace(*rows)
    return xp.stack(xp.broadcast_arrays(*rows), axis=axis)
