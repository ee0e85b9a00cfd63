"""The column of README's table that says how often an effect is named first."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.recalling.cases import first_named

BEGIN, END = "<!-- recall: begin -->\n", "<!-- recall: end -->"
NOT_MEASURED = "–"


def column(lines: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Effect -> in how many of its cases it is named first, as `2 of 3`."""
    right: dict[str, list[bool]] = {}
    for entry in lines:
        name, hit = first_named(entry)
        right.setdefault(name, []).append(hit)
    return {name: f"{sum(hits)} of {len(hits)}" for name, hits in right.items()}


def written(text: str, cells: Mapping[str, str]) -> str:
    """A page's text with the last column of its table filled in.

    Args:
        text: Of a page; the rows of its table begin with an effect's name.
        cells: Of that column, by effect; `NOT_MEASURED` stands for the others.

    Raises:
        ValueError: The page has no marks, or no row for an effect.
    """
    if BEGIN not in text or END not in text.split(BEGIN, 1)[1]:
        raise ValueError(f"no lines {BEGIN.strip()} and {END} about the table: write them")
    before, rest = text.split(BEGIN, 1)
    table, after = rest.split(END, 1)
    rows, left = [], dict(cells)
    for line in table.splitlines():
        if line.startswith("| `"):
            name = line.split("`")[1]
            kept = line.rstrip().removesuffix("|").rpartition("|")[0]
            line = f"{kept}| {left.pop(name, NOT_MEASURED)} |"
        rows.append(line)
    if left:
        raise ValueError(f"the table has no row for {', '.join(left)}: write one")
    return before + BEGIN + "\n".join(rows) + "\n" + END + after


def write_column(page: Path, lines: Sequence[Mapping[str, Any]]) -> None:
    """Fills in the column of a page from the lines of a ledger."""
    page.write_text(written(page.read_text(), column(lines)))
