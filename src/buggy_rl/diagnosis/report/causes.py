"""What the page says of causes: those that were tried, those that are named, those that lost."""

from collections.abc import Sequence

from buggy_rl.diagnosis.answer import Named
from buggy_rl.diagnosis.constancy import WORDS
from buggy_rl.diagnosis.report import wording
from buggy_rl.diagnosis.report.markup import (
    Bar,
    Markup,
    bars,
    listed,
    section,
    table,
    tag,
    titled,
)
from buggy_rl.diagnosis.report.ranking import losers, ranking
from buggy_rl.diagnosis.search import Found, Search
from buggy_rl.diagnosis.selection import NATS
from buggy_rl.estimation.hypothesis import Library

SHOWN = 10  # single causes in the chart of evidence
CLOSEST = 5  # rivals that are told of


def candidates(search: Search, found: Found) -> Markup:
    """What was tried, and what speaks for it."""
    ranks = ranking(search, found, SHOWN)
    most = max((rank.nats for rank in ranks), default=0.0) or 1.0
    rows = [
        Bar(
            " + ".join(wording.cause(c) for c in rank.causes),
            rank.nats / most if most > 0 else 0.0,
            f"{rank.nats:+.0f} nats",
            rank.chosen,
        )
        for rank in ranks
    ]
    chosen = (
        "Strong colour: the explanation that was chosen."
        if found.best.causes
        else "None was chosen: none helps enough, or in enough places, to be believed."
    )
    return section(
        "What could be the cause",
        tag(
            "p",
            "How much better each foretells moments that it was not fitted to than the simulator "
            f"as given does. {chosen}",
        ),
        bars(rows),
        tag(
            "p",
            "A nat is a natural unit of evidence: were moments independent, 2.3 of them would make "
            f"a cause ten times as likely. A cause needs at least {NATS:.0f} for each number it "
            "brings, in whatever part of the drives, and has to help at most of them.",
            of="quiet",
        ),
    )


def named(library: Library, effects: Sequence[Named], retuned: bool = False) -> Markup:
    """Each cause: words, equation, numbers.

    Args:
        library: With what the simulator as given has of each.
        effects: The causes.
        retuned: Whether parameters among them were fitted all together.
    """
    if not effects:
        return section("What is missing", tag("p", "Nothing is named."))
    return section("What is missing, in numbers", *(_effect(library, e, retuned) for e in effects))


def _effect(library: Library, effect: Named, retuned: bool) -> Markup:
    numbers = {p.name: p for p in library.numbers(effect.name)}
    rows = [
        (
            wording.plain(name),
            wording.number(v.value) + wording.unit(v.unit),
            wording.interval(v.low, v.high, v.unit),
            _neutral(numbers[name].value, v.unit),
        )
        for name, v in effect.parameters.items()
    ]
    warnings = [
        tag(
            "p",
            f"{wording.plain(p)} lies at the end of its range: take it as a hint.",
            of="warning",
        )
        for p in effect.at_bound
    ]
    if effect.varies_with:
        changing = (
            "Its numbers are not the same everywhere: they change with "
            f"{WORDS[effect.varies_with]}. So it is rather something that resembles it."
        )
        warnings.append(tag("p", changing, of="warning"))
    said = effect.sentence[:1].upper() + effect.sentence[1:]
    share = wording.percent(effect.held_out_gain)
    closes = (
        f"All parameters that were re-tuned close {share} of the gap together."
        if retuned and effect.kind == "parameter"
        else f"It closes {share} of the gap that is there without it, on what was held out."
    )
    return tag(
        "div",
        tag(
            "h3", f"{wording.cause(effect.name)} ({effect.kind}), {wording.sure(effect.confidence)}"
        ),
        tag("p", f"{said}.", of="lead"),
        tag("code", effect.equation, of="equation") if effect.equation else "",
        table(("", "found", "95% interval", "as given"), rows),
        tag("p", " ".join(numbers[name].meaning for name in effect.parameters), of="quiet"),
        *warnings,
        tag("p", closes),
        of="effect",
    )


def _neutral(value: float, symbol: str) -> str:
    """What the simulator has; values that stand for never are said so."""
    return "none" if abs(value) >= 1e3 else wording.number(value) + wording.unit(symbol)


def excluded(search: Search, found: Found, effects: Sequence[Named]) -> Markup:
    """What it is not, and what it might be all the same."""
    parts: list[str] = []
    searched = [effect for effect in effects if effect.name in found.best.causes]
    for effect in searched:
        lost = losers(search, found, effect.name)
        might = [
            f"{wording.cause(n)}, {wording.percent(p)}" for n, p in effect.confused_with.items()
        ]
        tried = [
            f"{wording.cause(n) if n else 'nothing in its place'}: worse by {nats:.0f} nats"
            for n, nats in lost
            if n not in effect.confused_with
        ][:CLOSEST]
        parts += [
            tag("h3", f"In place of {wording.cause(effect.name)}"),
            titled("Cannot be ruled out", might, "h4"),
            titled("Tried and lost", tried, "h4"),
        ]
    if not searched:
        close = ranking(search, found, 3)
        nothing = (
            "Parameters were re-tuned all at once, none against another; no effect is named beside "
            "them. Closest came:"
            if effects
            else "Nothing is named, so nothing is excluded by name. Closest came:"
        )
        parts.append(tag("p", nothing))
        parts.append(listed([f"{wording.cause(r.causes[0])}: {r.nats:+.0f} nats" for r in close]))
    return section("What it is not", *parts)
