"""Pieces of HTML: all text that goes in comes out escaped."""

import html
import math
from collections.abc import Sequence
from dataclasses import dataclass


class Markup(str):
    """Text that is HTML already."""

    __slots__ = ()


@dataclass(frozen=True)
class Bar:
    """One row of a chart of bars."""

    label: str
    share: float
    """Length in 0..1; what lies outside ends there, and what is no number has none."""
    value: str
    """The number beside it."""
    strong: bool = False
    """Whether it is the one that is talked about."""


def escaped(text: str) -> Markup:
    """Text as HTML; markup stays what it is."""
    return text if isinstance(text, Markup) else Markup(html.escape(str(text)))


def tag(name: str, *content: str, of: str = "") -> Markup:
    """An element around its content, of a class."""
    kind = f' class="{html.escape(of)}"' if of else ""
    return Markup(f"<{name}{kind}>{joined(content)}</{name}>")


def joined(parts: Sequence[str]) -> Markup:
    """Pieces one after the other."""
    return Markup("".join(escaped(part) for part in parts))


def listed(items: Sequence[str]) -> Markup:
    """Points; nothing where there are none."""
    return tag("ul", *(tag("li", item) for item in items)) if items else Markup("")


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Markup:
    """A table whose first column names the row."""
    cells = [
        tag("tr", tag("th", first), *(tag("td", cell) for cell in others))
        for first, *others in rows
    ]
    top = tag("tr", *(tag("th", cell) for cell in head))
    return tag("div", tag("table", tag("thead", top), tag("tbody", *cells)), of="scroll")


def bars(rows: Sequence[Bar]) -> Markup:
    """Horizontal bars with their labels and numbers; readable without the colours."""
    return tag("div", *(_bar(row) for row in rows), of="bars")


def _bar(row: Bar) -> Markup:
    width = 100 * min(max(row.share, 0.0), 1.0) if math.isfinite(row.share) else 0.0
    return tag(
        "div",
        tag("span", row.label, of="label"),
        tag("span", Markup(f'<i style="width:{width:.1f}%"></i>'), of="track"),
        tag("span", row.value, of="value"),
        of="bar strong" if row.strong else "bar",
    )


def figure(drawing: str, caption: str) -> Markup:
    """A picture and what is to be seen in it."""
    return tag("figure", Markup(drawing), tag("figcaption", caption))


def section(title: str, *content: str) -> Markup:
    """A part of the page."""
    return tag("section", tag("h2", title), *content)


def titled(title: str, items: Sequence[str], level: str = "h3") -> Markup:
    """A list under its title; nothing at all where it is empty."""
    return joined((tag(level, title), listed(items))) if items else Markup("")
