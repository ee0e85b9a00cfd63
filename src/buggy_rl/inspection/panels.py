"""What is drawn of an inspection."""

from collections.abc import Sequence

import numpy as np
from numpy import ndarray

from buggy_rl.inspection.columns import Guess
from buggy_rl.inspection.drive import DriveFacts
from buggy_rl.inspection.folder import Inspection
from buggy_rl.inspection.signals import STEP, clipped, correlations
from buggy_rl.viz.inspection import Panels

MOST = 8  # drives whose delays are drawn


def panels(found: Inspection) -> Panels:
    """Maps, coverage and delays of an inspection."""
    posed = [(d.name, d.signals) for d in found.drives if d.signals is not None]
    maps = [(name, np.where(s.known[:, None], s.xy, np.nan), np.abs(s.speed)) for name, s in posed]
    spread = sorted(maps, key=lambda m: -len(m[1]))
    delays = {
        f"{channel} and {response(guess)}": _delays(found.drives, channel, guess)
        for channel, guess in found.commands.items()
    }
    seen = found.seen
    return Panels(spread, seen.speed, seen.steering, seen.throttle, delays)


def response(guess: Guess) -> str:
    """What a command is compared with."""
    if "curvature" in guess.evidence:
        return "curvature"
    return "speed" if guess.unit == "m/s" else "acceleration"


def _delays(
    drives: Sequence[DriveFacts], channel: str, guess: Guess
) -> list[tuple[ndarray, ndarray]]:
    result = []
    for signals in [d.signals for d in drives if d.signals is not None]:
        if guess.column not in signals.columns:
            continue
        against = getattr(signals, response(guess))
        rows = signals.moving if channel == "steering" else signals.known
        values = guess.sign * signals.columns[guess.column]
        lags, found = correlations(values, clipped(against, rows), rows)
        if np.isfinite(found).any():
            result.append((lags * STEP, found))
    return sorted(result, key=lambda line: -np.nanmax(np.abs(line[1])))[:MOST]
