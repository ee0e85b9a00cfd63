"""Names of the computing modules in the words of somebody who drives."""

import math

from buggy_rl.diagnosis.answer import Verdict
from buggy_rl.diagnosis.localisation import Region
from buggy_rl.estimation.hypothesis import OWN

VERDICTS: dict[Verdict, str] = {
    "missing_physics": "missing physics",
    "wrong_parameters": "wrong parameters",
    "unknown_physics": "unknown physics",
    "no_mismatch": "no mismatch",
    "cannot_tell": "cannot tell",
}
MEANINGS: dict[Verdict, str] = {
    "missing_physics": "With what is named below in it, the simulator foretells drives it was not "
    "fitted to.",
    "wrong_parameters": "What is named below is in the simulator already, with wrong numbers; here "
    "are the right ones.",
    "unknown_physics": "There is a gap that no cause in the library closes well enough to be "
    "called its name. What is named below, if anything, is at most a part of it.",
    "no_mismatch": "Nothing is named because nothing has to be: what is left is the sensor's noise "
    "or too small to matter.",
    "cannot_tell": "More than one cause would explain these drives about as well. Names below are "
    "candidates, not answers; the last section says what to drive to decide.",
}
FEATURES = {  # feature -> words, unit, how many of the unit are 1 of what is computed with
    "vx": ("speed", "m/s", 1.0),
    "steering": ("steering command", "", 1.0),
    "throttle": ("throttle command", "", 1.0),
    "steering_rate": ("steering movement", "commands/s", 1.0),
    "lateral_acceleration": ("sideways acceleration", "m/s²", 1.0),
    "heading": ("heading", "°", 180 / math.pi),
    "elapsed": ("time since the start", "s", 1.0),
    "x": ("place along x", "m", 1.0),
    "y": ("place along y", "m", 1.0),
}
CHANNELS = {
    "x": "position lengthwise",
    "y": "position sideways",
    "yaw": "heading",
    "vx": "speed (vx)",
    "vy": "sideways speed (vy)",
    "yaw_rate": "turning (yaw rate)",
}


def cause(name: str) -> str:
    """An effect or a parameter of the simulator, for reading."""
    if not name:
        return "the simulator as given"
    if name.startswith(OWN):
        return f"the simulator's {plain(name.removeprefix(OWN))}"
    return plain(name.rpartition(":")[2])


def plain(name: str) -> str:
    """An identifier without its underscores."""
    return name.replace("_", " ")


def unit(symbol: str) -> str:
    """A unit as it is printed, with the space before it."""
    symbol = symbol.replace("^2", "²")
    return f" {symbol}" if symbol and symbol != "-" else ""


def number(value: float) -> str:
    """Three digits, no more than the drives can tell."""
    return f"{value:.3g}"


def coarse(value: float) -> str:
    """Two digits, for the ends of a region: they are only where a bin ended."""
    return f"{value:.0f}" if abs(value) >= 10 else f"{value:.2g}"


def interval(low: float, high: float, symbol: str = "") -> str:
    """Bounds of what a value lies in."""
    return f"{number(low)} to {number(high)}{unit(symbol)}"


def percent(share: float) -> str:
    """A share; never rounded to all or nothing where it is not."""
    if 0 < share < 0.005:
        return "under 1%"
    return f"{share:.0%}"


def sure(confidence: float) -> str:
    """How sure a name is."""
    return f"{percent(confidence)} sure"


def region(found: Region) -> str:
    """Where in what was driven errors crowd."""
    parts = []
    for name, (low, high) in found.where.items():
        words, symbol, scale = FEATURES.get(name, (plain(name), "", 1.0))
        parts.append(f"{words} {coarse(low * scale)} to {coarse(high * scale)}{unit(symbol)}")
    place = " and ".join(parts)
    return (
        f"{place[:1].upper()}{place[1:]}: {percent(found.error_share)} of the error in "
        f"{percent(found.data_share)} of the driving"
    )


def lags(found: dict[str, dict[str, float]]) -> list[str]:
    """Which errors follow which command, and how long after it."""
    return [
        f"Errors in {CHANNELS[channel]} come about {1000 * lag:.0f} ms after the {command} moves"
        for command, channels in found.items()
        for channel, lag in channels.items()
        if math.isfinite(lag)
    ]
