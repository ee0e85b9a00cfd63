"""The inspection as one HTML file that needs no other."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, PrefixLoader, StrictUndefined
from numpy import ndarray

from buggy_rl.figures.inspection import Panels, coverage_figure, lag_figure, map_figure
from buggy_rl.figures.style import svg
from buggy_rl.inspection.columns import Guess
from buggy_rl.inspection.drive import DriveFacts
from buggy_rl.inspection.folder import Inspection
from buggy_rl.inspection.signals import STEP, clipped, lagged_correlations


def inspection_page(found: Inspection, panels: Panels) -> str:
    """HTML of an inspection.

    Args:
        found: What was found.
        panels: What is drawn of it.
    """
    loader = PrefixLoader(
        {
            "inspection": PackageLoader("buggy_rl.inspection", ""),
            "report": PackageLoader("buggy_rl.diagnosis.report", ""),
        }
    )
    templates = Environment(
        loader=loader,
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=StrictUndefined,
    )
    figures = {
        "What was driven: each drive on its floor, by speed.": map_figure,
        "Speed, steering and throttle that were driven.": coverage_figure,
        "Delays: correlation of a command with what the car does that much later.": lag_figure,
    }
    drawn = [(words, svg(draw, panels, words)) for words, draw in figures.items()]
    return templates.get_template("inspection/inspection.html.jinja").render(
        found=found,
        figures=drawn,
        clocks=[row for drive in found.drives for row in clock_rows(drive)],
        delays=[row for drive in found.drives for row in delay_rows(drive)],
        notes=[(drive.name, note) for drive in found.drives for note in drive.notes],
        seconds=sum(d.pose.clock.seconds for d in found.drives if d.pose is not None),
    )


def clock_rows(drive: DriveFacts) -> list[dict[str, Any]]:
    """A row for each table of a drive: rows, rate, jitter, gaps."""
    return [
        {
            "drive": drive.name,
            "table": table,
            "rows": len(clock.t),
            "seconds": clock.seconds,
            "rate": 1 / clock.period,
            "jitter": 100 * clock.jitter,
            "gaps": len(clock.gaps),
            "longest": float(clock.gaps.max()) if len(clock.gaps) else 0.0,
            "is_pose": drive.pose is not None and drive.pose.table == table,
        }
        for table, clock in drive.clocks.items()
    ]


def delay_rows(drive: DriveFacts) -> list[dict[str, Any]]:
    """A row for each command of a drive: its column, delay and correlation."""
    guesses = {"steering": drive.steering, "throttle": drive.throttle}
    return [
        {"drive": drive.name, "channel": channel, "column": guess.column, "text": guess.evidence}
        for channel, guess in guesses.items()
        if guess is not None
    ]


MOST = 8  # drives whose delays are drawn


def inspection_panels(found: Inspection) -> Panels:
    """Maps, coverage and delays of an inspection."""
    posed = [(d.name, d.signals) for d in found.drives if d.signals is not None]
    maps = [(name, np.where(s.known[:, None], s.xy, np.nan), np.abs(s.speed)) for name, s in posed]
    spread = sorted(maps, key=lambda m: -len(m[1]))
    delays = {
        f"{channel} and {_response(guess)}": _delays(found.drives, channel, guess)
        for channel, guess in found.commands.items()
    }
    seen = found.seen
    return Panels(spread, seen.speed, seen.steering, seen.throttle, delays)


def _response(guess: Guess) -> str:
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
        against = getattr(signals, _response(guess))
        rows = signals.moving if channel == "steering" else signals.known
        values = guess.sign * signals.columns[guess.column]
        lags, found = lagged_correlations(values, clipped(against, rows), rows)
        if np.isfinite(found).any():
            result.append((lags * STEP, found))
    return sorted(result, key=lambda line: -np.nanmax(np.abs(line[1])))[:MOST]
