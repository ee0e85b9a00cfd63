"""Names and numbers of the computing modules as the report prints them."""

import math
from dataclasses import dataclass

from buggy_rl.diagnosis.answer.answer import Verdict
from buggy_rl.diagnosis.answer.behaviour import Behaviour, FormFault
from buggy_rl.diagnosis.answer.located import Region
from buggy_rl.diagnosis.answer.named_effect import SUREST
from buggy_rl.diagnosis.repair.layers import Layer
from buggy_rl.diagnosis.residuals import CONDITIONS, READINGS, Condition
from buggy_rl.diagnosis.search.candidate import substitutes
from buggy_rl.diagnosis.search.result import SearchResult
from buggy_rl.effects import effect_class
from buggy_rl.estimation.hypothesis import OWN

MOST_DIGITS = 6  # of a bound of an interval
MEANINGS: dict[Verdict, str] = {
    "missing_physics": "With the effects below, the simulator predicts recordings that it was not "
    "fitted to.",
    "wrong_parameters": "The simulator has the physics but wrong values of the parameters below; "
    "the fitted values are given.",
    "unknown_physics": "There is a residual that no effect in the library explains well enough. "
    "Effects named below, if any, explain at most a part of it.",
    "no_mismatch": "No effect is named because none is needed: the residual is sensor noise or "
    "negligible.",
    "cannot_tell": "More than one hypothesis explains these recordings about as well: the effects "
    "below are candidates. What to drive next says which manoeuvres decide.",
}


def effect(name: str) -> str:
    """An effect, or a parameter of the simulator's own."""
    if not name:
        return "no effect"
    if name.startswith(OWN):
        return f"the simulator's {plain(name.removeprefix(OWN))}"
    return plain(name.rpartition(":")[2])


def channel_words(name: str) -> str:
    """A reading of the sensor."""
    return READINGS[name].listed or READINGS[name].words


def plain(name: str) -> str:
    """An identifier without its underscores."""
    return name.replace("_", " ")


def capital(text: str) -> str:
    """Text with its first letter in upper case; the others stay as they are."""
    return text[:1].upper() + text[1:]


def unit(symbol: str) -> str:
    """A unit as it is printed, with the space before it."""
    symbol = symbol.replace("^2", "²")
    return f" {symbol}" if symbol and symbol != "-" else ""


def number(value: float) -> str:
    """Three significant digits."""
    return f"{value:.3g}"


def quantity(value: float, symbol: str) -> str:
    """A number with its unit; less than a second in milliseconds."""
    scale, symbol = _scaled(abs(value), symbol)
    return number(scale * value) + unit(symbol)


def between(bounds: tuple[float, float], symbol: str) -> str:
    """Bounds of an interval with as many digits as tell them apart; empty where it has no width."""
    scale, symbol = _scaled(max(map(abs, bounds)), symbol)
    for digits in range(3, MOST_DIGITS):
        low, high = (f"{scale * bound:.{digits}g}" for bound in bounds)
        if low != high:
            return f"{low} to {high}{unit(symbol)}"
    return ""


def repaired_quantity(found: Behaviour) -> str:
    """A quantity of the repaired simulator with its interval; unchanged, if it has none."""
    bounds = between((found.low, found.high), found.unit)
    value = quantity(found.value, found.unit)
    if not bounds and value == quantity(found.given, found.unit):
        return "unchanged"
    return f"{value} ({bounds})" if bounds else value


def _scaled(size: float, symbol: str) -> tuple[float, str]:
    """How many of the unit that is printed are one of a unit, and that unit."""
    return (1000.0, "ms") if symbol == "s" and size < 1 else (1.0, symbol)


def neutral(value: float, symbol: str) -> str:
    """What the simulator has; a limit that is never reached is none."""
    return "none" if abs(value) >= 1e3 else quantity(value, symbol)


def percent(share: float) -> str:
    """A share; a small one is not rounded to 0%."""
    return "under 1%" if 0 < share < 0.005 else f"{share:.0%}"


def confidence(probability: float) -> str:
    """A confidence, as sure at most as the sentences say it."""
    return percent(min(probability, SUREST))


def sentence(fault: FormFault) -> str:
    """A fault of the form, as a list item."""
    return f"{capital(fault.line()).replace('^2', '²')}."


def closes(share: float) -> str:
    """How much of the residual an effect closes; an estimate beyond all or none is one of these."""
    if not math.isfinite(share) or share < 0.005:
        return "none"
    return "all" if share >= 0.995 else percent(share)


def look_at(name: str) -> str:
    """What to check on the car for an effect; of a parameter, what it is compared with."""
    if name.startswith(OWN):
        return f"Compare {plain(name.removeprefix(OWN))} of the simulator with that of the car."
    return effect_class(name).look_at


def width(share: float) -> str:
    """Length of a bar [% of its track]; 0 where the share is not finite."""
    return f"{100 * min(max(share, 0.0), 1.0) if math.isfinite(share) else 0.0:.1f}"


def region(found: Region) -> str:
    """Range of the features in which errors are large, and its shares."""
    parts = []
    for name, (low, high) in found.where.items():
        of = CONDITIONS.get(name) or Condition(plain(name))
        words, symbol = of.listed or of.words, of.listed_unit or of.unit
        bounds = f"{_coarse(low * of.scale)} to {_coarse(high * of.scale)}"
        parts.append(f"{words} {bounds}{unit(symbol)}")
    return (
        f"{capital(' and '.join(parts))}: {percent(found.error_share)} of the error in "
        f"{percent(found.data_share)} of the data"
    )


def _coarse(value: float) -> str:
    """Two digits: a region ends where a bin does."""
    return f"{value:.0f}" if abs(value) >= 10 else f"{value:.2g}"


def lags(found: dict[str, dict[str, float]]) -> list[str]:
    """Which errors follow which command, and how long after it."""
    return [
        f"Errors in {channel_words(channel)} follow changes of the {command} by {1000 * lag:.0f} ms"
        for command, channels in found.items()
        for channel, lag in channels.items()
        if math.isfinite(lag)
    ]


def layer(of: Layer) -> str:
    """A layer of the repaired simulator."""
    if of.kind == "effects":
        return " + ".join(effect(name) for name in of.names)
    if of.kind == "parameters":
        count = len(of.names)
        return f"{count} parameters of its own" if count > 1 else plain(of.names[0])
    if of.kind == "terms":
        return f"{len(of.names)} equations" if len(of.names) > 1 else "an equation"
    return "a learned residual"


def millimetres(metres: float) -> str:
    """A distance [m] in words."""
    return f"{1000 * metres:.0f} mm" if metres >= 0.01 else f"{1000 * metres:.1f} mm"


def distance(square: float | None, median: float | None) -> str:
    """Root of a mean square [m^2] and, in brackets, a median [m]; a dash where there is none."""
    if square is None or not math.isfinite(square):
        return "–"
    bracket = "" if median is None else f" ({1000 * median:.0f})"
    return f"{1000 * math.sqrt(square):.0f} mm{bracket}"


FILTERS = {
    f.__name__: f
    for f in (
        effect,
        plain,
        capital,
        number,
        quantity,
        between,
        repaired_quantity,
        closes,
        look_at,
        neutral,
        percent,
        confidence,
        width,
        region,
        sentence,
    )
} | {"channel": channel_words}


@dataclass(frozen=True)
class Rank:
    """A hypothesis and how much better than the simulator as given it predicts."""

    effects: tuple[str, ...]
    nats: float
    """Decrease of the held-out loss, prior penalty included; below 0 where it predicts worse."""
    chosen: bool


def ranking(found: SearchResult, most: int) -> list[Rank]:
    """The selected hypothesis, then single effects, best first; at most so many of these."""
    base = found.loss(found.null)
    chosen = found.best.effects
    singles = [
        Rank(effects, base - found.loss(candidate), effects == chosen)
        for effects, candidate in found.tried.items()
        if len(effects) == 1
    ]
    singles = sorted(singles, key=lambda rank: -rank.nats)[:most]
    if not chosen or any(rank.chosen for rank in singles):
        return singles
    return [Rank(chosen, base - found.loss(found.best), True), *singles]


def alternatives(found: SearchResult, effect: str) -> list[tuple[str, float]]:
    """Effects tried instead of one, "" for none, and how much worse [nats]; the closest first."""
    best = found.loss(found.best)
    tried = substitutes(found.tried, frozenset(found.best.effects) - {effect})
    result = [(other, found.loss(c) - best) for other, c in tried.items() if other != effect]
    return sorted(result, key=lambda item: item[1])
