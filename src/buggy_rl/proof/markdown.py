"""Pages as Markdown: templates, tables, and tables that stand within pages written by hand.

Such a table stands between two lines, `<!-- NAME: begin -->` and `<!-- NAME: end -->`.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from buggy_rl.core.files import write_atomically


def page_of(package: str, template: str, **content: Any) -> str:
    """A page from a template of a package, which may use `table`."""
    templates = Environment(
        loader=PackageLoader(package, ""),
        trim_blocks=True,
        keep_trailing_newline=True,
        undefined=StrictUndefined,
    )
    return templates.get_template(template).render(table=table, **content)


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table.

    >>> print(table(["case", "n"], [["nothing", 3]]))
    | case | n |
    | --- | --- |
    | nothing | 3 |
    """
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(map(str, line))} |" for line in lines)


def marked(text: str, name: str) -> tuple[str, str, str]:
    """What stands before, between and behind the marks of a name, without the marks.

    Raises:
        ValueError: The text has no such marks.
    """
    begin, end = table_marks(name)
    before, found, rest = text.partition(begin)
    between, closed, behind = rest.partition(end)
    if not (found and closed):
        raise ValueError(f"no lines {begin.strip()} and {end} about the table: write them")
    return before, between, behind


def table_marks(name: str) -> tuple[str, str]:
    """The lines about the table of a name."""
    return f"<!-- {name}: begin -->\n", f"<!-- {name}: end -->"


def with_table(text: str, name: str, content: str) -> str:
    """A text with other content between the marks of a name; `marked`'s arguments and errors."""
    begin, end = table_marks(name)
    before, _, behind = marked(text, name)
    return f"{before}{begin}{content}\n{end}{behind}"


def fill(page: Path, tables: Mapping[str, str]) -> None:
    """Writes those tables into a page for which it has marks.

    Args:
        page: Markdown file.
        tables: Name -> content.

    Raises:
        ValueError: It has marks for none of them.
    """
    text = page.read_text()
    found = [name for name in tables if table_marks(name)[0] in text]
    if not found:
        names = ", ".join(table_marks(name)[0].strip() for name in tables)
        raise ValueError(f"{page} has none of the lines {names}")
    for name in found:
        text = with_table(text, name, tables[name])
    write_atomically(page, text)
