"""Small array helpers that give the same bits for a row in a batch of any size.

Reductions over an axis may change their order of summation with the memory layout, so sums over
the four wheels or the bristle cells are written out. No matrix product (BLAS) is used anywhere.
"""

import numpy as np

Array = np.ndarray
Arrays = dict[str, np.ndarray]


def sum4(values: Array) -> Array:
    """Sum over the last axis of length 4 in a fixed order: [..., 4] -> [...]."""
    return (values[..., 0] + values[..., 1]) + (values[..., 2] + values[..., 3])


def limit(values: Array, low: Array | float, high: Array | float) -> Array:
    """Clip to [low, high]; faster than numpy.clip for small arrays."""
    return np.minimum(np.maximum(values, low), high)


def col(values: Array) -> Array:
    """[N] -> [N, 1], to combine a value per car with values per wheel [N, 4]."""
    return values[:, None]


def per_car(value: Array | float, cars: int) -> Array:
    """A float or an array [N] as a fresh float array [N]."""
    return np.array(np.broadcast_to(np.asarray(value, dtype=float), (cars,)))


def to_world(yaw: Array, x: Array, y: Array) -> tuple[Array, Array]:
    """Rotate body vectors (x, y), [N] or [N, 4], to the world frame; yaw [N], rad."""
    cosine, sine = np.cos(yaw), np.sin(yaw)
    if x.ndim == 2:
        cosine, sine = col(cosine), col(sine)
    return cosine * x - sine * y, sine * x + cosine * y


def to_body(yaw: Array, x: Array, y: Array) -> tuple[Array, Array]:
    """Rotate world vectors (x, y), [N] or [N, 4], to the body frame; yaw [N], rad."""
    return to_world(-yaw, x, y)
