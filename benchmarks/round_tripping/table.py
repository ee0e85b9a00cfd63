"""Counts of the round trip: how often the first name is right, by car and rate."""

from collections.abc import Mapping, Sequence

from benchmarks.round_tripping.cases import BRAKED, ONE_WAY

from buggy_rl.proof.score.figures import share

CARS = {1.0: "1:10", 2.0: "1:5", 10.0: "full size"}
Row = Mapping[str, str]


def table(rows: Sequence[Row]) -> str:
    """Markdown: cases, right first names and their 95 % interval of each car and rate."""
    scales = sorted({float(r["scale"]) for r in rows})
    rates = sorted({int(r["rate"]) for r in rows})
    lines = [
        "| car | rate [Hz] | first name right | 95 % interval | named at all |",
        "|---|--:|--:|--:|--:|",
        _line("1:10, one-way throttle", "100", [r for r in rows if r["pairing"] == ONE_WAY]),
    ]
    braked = [r for r in rows if r["pairing"] == BRAKED]
    for scale in scales:
        for rate in rates:
            lines.append(_line(*_names(scale, rate), _where(braked, scale, rate)))
    for scale in scales:
        lines.append(_line(CARS.get(scale, f"{scale:g}"), "all", _where(braked, scale)))
    lines += [_line("all", str(rate), _where(braked, rate=rate)) for rate in rates]
    return "\n".join(lines)


def _names(scale: float, rate: int) -> tuple[str, str]:
    return CARS.get(scale, f"{scale:g} times the buggy"), str(rate)


def _where(rows: Sequence[Row], scale: float | None = None, rate: int | None = None) -> list[Row]:
    kept = [r for r in rows if scale is None or float(r["scale"]) == scale]
    return [r for r in kept if rate is None or int(r["rate"]) == rate]


def _line(car: str, rate: str, rows: Sequence[Row]) -> str:
    count, right = len(rows), sum(int(r["right"]) for r in rows)
    if not count:
        return f"| {car} | {rate} | - | - | - |"
    found = share([r["right"] == "1" for r in rows])
    named = sum(int(r["named"]) for r in rows)
    return (
        f"| {car} | {rate} | {right} of {count} | {found.low:.0%} to {found.high:.0%} | {named} |"
    )
