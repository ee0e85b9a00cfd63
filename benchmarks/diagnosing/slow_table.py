"""What slow_simulators.py measured, as Markdown."""

from collections.abc import Iterable
from pathlib import Path

from diagnosing.job import Row

LOST = "environment steps a second:"  # in the note that says what a smaller budget loses


def table(rows: Iterable[Row]) -> str:
    """One line a diagnosis."""
    lines = [
        "| simulator | both drives [s] | workers | load before | promised [s] | seconds | CPU s "
        "| memory [MB] | first name | left out |",
        "|---|--:|--:|--:|--:|--:|--:|--:|---|---|",
    ]
    for row in rows:
        first = row["named"][0] if row["named"] else ["nothing", 1.0]
        lost = [n.partition(LOST)[2].strip() for n in row["notes"] if LOST in n]
        lines.append(
            f"| {Path(row['simulator']).name} | {row['seconds']:g} | {row['workers']} "
            f"| {row['load']:.1f} | {row['promised']:.0f} at {row['promised_at']:.0f} s "
            f"| {row['total']:.0f} | {row['cpu']:.0f} | {row['memory_mb']:,.0f} "
            f"| {first[0]}, {100 * first[1]:.0f} %{' (right)' if row['right'] else ''} "
            f"| {'; '.join(lost) or 'nothing'} |"
        )
    return "\n".join(lines)
