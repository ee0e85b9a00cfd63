"""The table of the campaign, from its file."""

import math
from pathlib import Path

import numpy as np
import pandas as pd

from faults.injection import FAULTS

PLACE = "car_faults"  # of the table in a page, between its marks


def summary(file: Path) -> str:
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
    return "\n".join(lines)
