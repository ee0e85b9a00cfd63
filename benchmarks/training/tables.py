"""What was measured, as Markdown."""

import statistics
from collections.abc import Iterable
from pathlib import Path
from typing import Any

Row = dict[str, Any]


def tables(rows: Iterable[Row]) -> str:
    """Speeds, times to the score and profiles, as far as there are any."""
    found = list(rows)
    parts = (speed_table(found), score_table(found), profile_table(found))
    return "\n\n".join(part for part in parts if part)


def speed_table(rows: Iterable[Row]) -> str:
    """Speeds as Markdown, the rounds of a case together."""
    grouped: dict[tuple[str, int], dict[str, list[Row]]] = {}
    for row in rows:
        if row["kind"] == "speed":
            group = grouped.setdefault((row["simulator"], row["threads"]), {})
            group.setdefault(row["case"], []).append(row)
    lines = [
        "| simulator | threads | case | steps/s median | best | steps/CPU s | ours over it "
        "| peak memory MB |",
        "|---|--:|---|--:|--:|--:|--:|--:|",
    ]
    for (simulator, threads), group in grouped.items():
        medians = {case: median(found) for case, found in group.items()}
        for case, found in group.items():
            start = f"| {Path(simulator).name} | {threads} | {case} "
            if medians[case] is None:
                lines.append(f"{start}| failed: {found[0]['failed']} | | | | |")
                continue
            good = [row for row in found if "failed" not in row]
            ratio = f"{medians['ours'] / medians[case]:.2f}" if medians.get("ours") else "-"
            lines.append(
                f"{start}| {medians[case]:,.0f} | {max(max(row['rates']) for row in good):,.0f} "
                f"| {statistics.median(row['per_cpu_second'] for row in good):,.0f} | {ratio} "
                f"| {max(row['peak_memory_mb'] for row in good):,.0f} |"
            )
    return "\n".join(lines) if grouped else ""


def median(found: Iterable[Row]) -> Any:
    """Of all repeats of all rounds; None when none succeeded."""
    rates = [rate for row in found for rate in row.get("rates", [])]
    return statistics.median(rates) if rates else None


def score_table(rows: Iterable[Row]) -> str:
    """Times to the score as Markdown."""
    lines = [
        "| simulator | threads | case | waypoints wanted | time of training | steps | best seen |",
        "|---|--:|---|--:|---|--:|--:|",
    ]
    for row in rows:
        start = f"| {Path(row['simulator']).name} | {row['threads']} | {row['case']} "
        if row["kind"] not in ("pursuit", "score"):
            continue
        if "failed" in row:
            lines.append(f"{start}| failed: {row['failed']} | | | |")
        elif row["kind"] == "pursuit":
            lines.append(f"{start}| | | | {row['waypoints']:.1f} |")
        else:
            took = f"{row['seconds']:,.1f} s"
            took = took if row["reached"] else f"not reached in {took}"
            lines.append(
                f"{start}| {row['target']:.1f} | {took} | {row['steps']:,} | {row['best']:.1f} |"
            )
    return "\n".join(lines) if len(lines) > 2 else ""


def profile_table(rows: Iterable[Row]) -> str:
    """Where the time goes, and the floor, as Markdown."""
    found = [row for row in rows if row["kind"] == "profile"]
    return "\n\n".join(
        f"{Path(row['simulator']).name}, {row['threads']} threads:\n\n"
        + (f"failed: {row['failed']}" if "failed" in row else profiled(row))
        for row in found
    )


def profiled(row: Row) -> str:
    """Parts and floor of one profile."""
    total = sum(row["parts"].values())
    lines = ["| part | µs a step | share |", "|---|--:|--:|"]
    lines += [f"| {name} | {t:.2f} | {t / total:.1%} |" for name, t in row["parts"].items()]
    lines.append(f"| **all** | **{total:.2f}** | {1e6 / total:,.0f} steps/s |")
    lines += ["", "| floor: products alone | multiply-adds a step | µs a step |", "|---|--:|--:|"]
    for name, part in row["floor"].items():
        lines.append(f"| {name} | {part['multiply_adds']:,} | {part['microseconds']:.2f} |")
    least = sum(part["microseconds"] for part in row["floor"].values())
    adds = sum(part["multiply_adds"] for part in row["floor"].values())
    lines.append(f"| **all** | **{adds:,}** | **{least:.2f}** ({least / total:.0%} of the loop) |")
    return "\n".join(lines)
