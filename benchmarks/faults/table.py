"""The table of the campaign, from its file into the pages."""

import math
from pathlib import Path

import numpy as np
import pandas as pd

from faults.injection import FAULTS

BEGIN, END = "<!-- car_faults: begin -->\n", "<!-- car_faults: end -->"


def summary(file: Path) -> list[str]:
    """A table of the file: a row for each fault, in the order of `FAULTS`."""
    table = pd.read_csv(file)
    lines = [
        "| fault | n | no drive, p50 [ms] | p99 | max | wheels straight, p50 [ms] | p99 | max | "
        "readable | missing, max [s] |",
        "|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    names = list(FAULTS)
    order = sorted(table["fault"].unique(), key=lambda fault: names.index(fault))
    for fault in order:
        rows = table[table["fault"] == fault]
        cells = [str(fault), str(len(rows))]
        for column in ("cut_ms", "neutral_ms"):
            values = np.quantile(rows[column], [0.5, 0.99, 1.0], method="higher")
            cells += [f"{v:.0f}" if math.isfinite(v) else "never" for v in values]
        cells += [str(np.sum(rows["readable"])), f"{np.max(rows['missing_s']):.2f}"]
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def write_table(page: Path, lines: list[str]) -> None:
    """Writes a table between the marks of a page.

    Raises:
        ValueError: It has no marks.
    """
    text = page.read_text()
    if BEGIN not in text or END not in text.split(BEGIN, 1)[1]:
        raise ValueError(f"{page}: has no lines {BEGIN.strip()} and {END}; write them into it")
    before, rest = text.split(BEGIN, 1)
    page.write_text(before + BEGIN + "\n".join(lines) + "\n" + END + rest.split(END, 1)[1])
