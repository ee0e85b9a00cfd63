"""What was measured, as Markdown."""

import statistics
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from diagnosing.job import Row

TARGETS = {"mujoco": 90.0}  # [s] of a diagnosis; of all PyTorch engines:
TARGET = 20.0  # [s]
MEMORY_TARGET = 4096.0  # [MB]
TOLD = {  # of a peer: what it is told
    "diagnosis": "nothing: the whole library and every parameter",
    "fit": "which parameter",
    "fit_all": "that it is one of the parameters",
    "sysid": "which parameter",
    "sysid_all": "that it is one of the parameters",
}
WHO = {"diagnosis": "ours, diagnosis", "fit": "ours, fit", "sysid": "mujoco.sysid"}


def tables(rows: Iterable[Row]) -> str:
    """Speeds, scales and peers, as far as there are any; the rounds of a job together."""
    found = medians(rows)
    parts = (speed_table(found), stage_table(found), scale_table(found), peer_table(found))
    return "\n\n".join(part for part in parts if part)


def medians(rows: Iterable[Row]) -> list[Row]:
    """One row a job: median of the times, largest of the memories, answers of the first round.

    A diagnosis gives one answer to one question, so that of the other rounds is the same.
    """
    groups: dict[tuple, list[Row]] = {}
    for row in rows:
        key = (row["kind"], row["name"], row["total_seconds"], row["asked"])
        groups.setdefault(key, []).append(row)
    result = []
    for group in groups.values():
        good = [row for row in group if "failed" not in row]
        if not good:
            result.append(group[0])
            continue
        times = {k: statistics.median(r[k] for r in good) for k in ("seconds", "cpu_seconds")}
        memory = max(row["peak_memory_mb"] for row in good)
        result.append({**good[0], **times, "peak_memory_mb": memory})
    return result


def speed_table(rows: Iterable[Row]) -> str:
    """Whole diagnoses by simulator."""
    lines = [
        "| simulator | baseline drives | candidates | seconds | CPU s | peak memory MB | met "
        "| named | dead time [ms] (95 %) | right |",
        "|---|---|--:|--:|--:|--:|---|---|---|---|",
    ]
    for row in (row for row in rows if row["kind"] == "speed"):
        start = f"| {Path(row['name']).name} "
        if "failed" in row:
            lines.append(f"{start}| failed: {row['failed']} | | | | | | | | |")
            continue
        target = TARGETS.get(row["name"], TARGET)
        met = row["seconds"] < target and row["peak_memory_mb"] < MEMORY_TARGET
        lines.append(
            f"{start}| {'two' if row['baseline'] else 'none'} | {row['candidates']} "
            f"| {row['seconds']:.1f} (of {target:.0f}) | {row['cpu_seconds']:.1f} "
            f"| {row['peak_memory_mb']:,.0f} | {_yes(met)} | {_named(row)} "
            f"| {_interval(row, 1e3)}, true {1e3 * row['truth']:.3g} | {_yes(row['right'])} |"
        )
    return "\n".join(lines) if len(lines) > 2 else ""


def stage_table(rows: Iterable[Row]) -> str:
    """Where the time of whole diagnoses goes, by their own words of progress."""
    found = [r for r in rows if r["kind"] == "speed" and "failed" not in r]
    stages = list(dict.fromkeys(stage for row in found for stage in row["stages"]))
    names = [Path(row["name"]).name for row in found]
    lines = [f"| stage [s] | {' | '.join(names)} |", "|---|" + "--:|" * len(names)]
    for stage in stages:
        cells = [f"{row['stages'][stage]:.1f}" if stage in row["stages"] else "" for row in found]
        lines.append(f"| {stage} | {' | '.join(cells)} |")
    return "\n".join(lines) if found else ""


def scale_table(rows: Iterable[Row]) -> str:
    """Time against the length of the drives and against the number of candidates."""
    lines = [
        "| both drives [s] | candidates | seconds | CPU s | peak memory MB | right |",
        "|--:|--:|--:|--:|--:|---|",
    ]
    for row in (row for row in rows if row["kind"] in ("length", "candidates")):
        start = f"| {row['total_seconds']:g} "
        if "failed" in row:
            lines.append(f"{start}| {row['asked'] or 'all'} | failed: {row['failed']} | | | |")
            continue
        lines.append(
            f"{start}| {row['candidates']} | {row['seconds']:.1f} | {row['cpu_seconds']:.1f} "
            f"| {row['peak_memory_mb']:,.0f} | {_yes(row['right'])} |"
        )
    return "\n".join(lines) if len(lines) > 2 else ""


def peer_table(rows: Iterable[Row]) -> str:
    """The same parameter by `mujoco.sysid` and by us."""
    found = [row for row in rows if row["kind"] == "peer"]
    lines = [
        "| who | is told | free | seconds | CPU s | value | 95 % interval | holds the truth |",
        "|---|---|--:|--:|--:|--:|---|---|",
    ]
    for row in found:
        start = f"| {WHO[row['name'].partition('_')[0]]} | {TOLD[row['name']]} "
        if "failed" in row:
            lines.append(f"{start}| failed: {row['failed']} | | | | | |")
            continue
        start += f"| {row.get('free') or row['candidates']} | {row['seconds']:.1f} "
        start += f"| {row['cpu_seconds']:.1f} "
        if row["value"] is None:
            lines.append(f"{start}| not named | named: {_named(row)} | no |")
            continue
        holds = row["low"] <= row["truth"] <= row["high"]
        ends = f"{row['low']:.4g} .. {row['high']:.4g}"
        lines.append(f"{start}| {row['value']:.4g} | {ends} | {_yes(holds)} |")
    if not found:
        return ""
    first = found[0]
    return f"{first['parameter']}, true {first['truth']:g}:\n\n" + "\n".join(lines)


def _named(row: Row) -> str:
    return ", ".join(row["named"]) or f"nothing ({row['verdict']})"


def _interval(row: Row, scale: float) -> str:
    if row["value"] is None:
        return "-"
    value, low, high = (scale * row[key] for key in ("value", "low", "high"))
    return f"{value:.3g} ({low:.3g} .. {high:.3g})"


def _yes(value: Any) -> str:
    return "yes" if value else "no"
