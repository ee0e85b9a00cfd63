"""Sparse regression on the motion that single steps lack, as SINDy does it, over the library."""

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from buggy_rl.proof.baselines.asked import named, open_question, parameter_interval, unnamed
from buggy_rl.proof.baselines.columns import DELAYED, Columns, residual_columns

FAINT = 0.1  # of a typical size: the threshold under which a coefficient is dropped


def sindy(seen: Path) -> dict[str, Any]:
    """Names the effect with the largest standardised coefficient.

    r = sum_f w_f c_f, sparsely (STLSQ of `pysindy`), with the columns c_f of
    `residual_columns`. What no
    effect can have, such as a negative dead time, is left out and the rest regressed again. The
    standardised coefficient of an effect is the root mean square of its terms over that of r; its
    confidence is the square of it among the squares of all that remain. Its size comes from the
    coefficient, with the interval of ordinary least squares. Command and reading have a column for
    each of `DELAYS`.

    Baseline drives are used as the diagnosis uses them: the simulator is corrected by a small
    network first.

    Raises:
        ImportError: `pysindy` is not installed.
    """
    found = residual_columns(open_question(seen))
    x = found.explained.flatten(1).T.numpy()  # (M, F)
    y = found.lacking.flatten().numpy()  # (M,)
    coefficients = sparse(x, y, [feature.both_ways for feature in found.features])
    standard = _standardised(found, coefficients, x, y)
    if not standard:
        return unnamed("no_mismatch", f"no coefficient is above {FAINT} of a typical size")
    name, largest = max(standard.items(), key=lambda item: item[1])
    share = largest**2 / sum(s**2 for s in standard.values())
    terms = ", ".join(f"{n} {s:.3f}" for n, s in sorted(standard.items(), key=lambda i: -i[1]))
    said = numbers(found, coefficients, _spread(x, y, coefficients), name)
    return named("missing_physics", name, share, said, [f"standardised coefficients: {terms}"])


def sparse(x: np.ndarray, y: np.ndarray, both_ways: Sequence[bool]) -> np.ndarray:
    """Coefficients [F] of columns [M, F] for the target [M]; negative only where that makes sense.

    Raises:
        ImportError: `pysindy` is not installed.
    """
    try:
        from pysindy import STLSQ
    except ImportError as error:
        raise ImportError(
            "sparse regression needs pysindy: pip install 'buggy_rl[proof]'"
        ) from error
    coefficients, sense = np.zeros(x.shape[1]), np.array(both_ways)
    open_ = np.flatnonzero(x.any(0))
    while len(open_):
        with warnings.catch_warnings():  # that nothing is left is an answer
            warnings.filterwarnings("ignore", "Sparsity parameter is too big")
            fit = STLSQ(threshold=FAINT).fit(x[:, open_], y[:, None])
        coefficients[:] = 0.0
        coefficients[open_] = np.asarray(fit.coef_).ravel()
        senseless = (coefficients < 0) & ~sense
        if not senseless.any():
            break
        open_ = np.setdiff1d(open_, np.flatnonzero(senseless))
    else:
        coefficients[:] = 0.0
    return coefficients


def _standardised(
    found: Columns, coefficients: np.ndarray, x: np.ndarray, y: np.ndarray
) -> dict[str, float]:
    """Effect -> root mean square of its terms over that of the target."""
    result = {}
    for effect in dict.fromkeys(feature.effect for feature in found.features):
        own = np.array([feature.effect == effect for feature in found.features])
        if coefficients[own].any():
            part = x[:, own] @ coefficients[own]
            result[effect] = float(np.sqrt((part**2).mean() / (y**2).mean()))
    return result


def _spread(x: np.ndarray, y: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Standard deviations [F] by ordinary least squares on the columns that were kept."""
    kept = np.flatnonzero(coefficients)
    left = y - x @ coefficients
    variance = left @ left / (len(y) - len(kept))
    spread = np.zeros_like(coefficients)
    inverse = np.linalg.pinv(x[:, kept].T @ x[:, kept])
    spread[kept] = np.sqrt(variance * inverse.diagonal())
    return spread


def numbers(
    found: Columns, coefficients: np.ndarray, spread: np.ndarray, name: str
) -> dict[str, dict[str, Any]]:
    """Numbers of an effect: all parts of a vector, of the places of a patch the strongest.

    Columns of several delays add up: to first order a signal that is late by the sum.
    """
    own = [i for i, feature in enumerate(found.features) if feature.effect == name]
    own.sort(key=lambda i: abs(coefficients[i]))
    if name in DELAYED:
        first = found.features[own[0]]
        [coordinate] = first.coordinates
        z = np.array([found.features[i].vector[0] for i in own])
        late, sd = float(coefficients[own] @ z), float(np.linalg.norm(spread[own] * z))
        return {coordinate.parameter.name: parameter_interval(coordinate.parameter, late, sd)}
    if not all(found.features[own[0]].scaled):
        own = own[-1:]
    said: dict[str, dict[str, Any]] = {}
    for i in own:
        said |= found.features[i].numbers(float(coefficients[i]), float(spread[i]))
    return said
