"""What a joint search comes to by the evidence alone, counted over development cases."""

from collections.abc import Mapping, Sequence
from typing import Any

from buggy_rl.blind_test.discrimination import PRICE
from buggy_rl.diagnosis.joint import FITTED
from buggy_rl.effects import EFFECTS

WORDS = {0: "nothing", 1: "one", 2: "two", 3: "three"}


def most_evident(entry: Mapping[str, Any]) -> list[str]:
    """Effects of the hypothesis with the largest evidence, less `PRICE` for each."""
    best = max(
        entry["hypotheses"],
        key=lambda h: h["evidence"]["log_evidence"] - PRICE * len(h["effects"]),
    )
    return list(best["effects"])


def counts(entries: Sequence[Mapping[str, Any]]) -> str:
    """A table in Markdown: cases, true sets that were fitted, and that are the most evident.

    By how many effects are concealed, and whether the simulator is of the plant's make; cases with
    physics that no effect describes are not in it.
    """
    lines = [
        "| concealed | of the plant's make | fitted | exact | of another make | fitted | exact |",
        "|---|--:|--:|--:|--:|--:|--:|",
    ]
    for size, word in WORDS.items():
        cells = [word]
        for own in (True, False):
            cells += _cells([e for e in entries if _is(e, size, own)], size)
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _is(entry: Mapping[str, Any], size: int, own: bool) -> bool:
    case, truth = entry["case"], set(entry["case"]["concealed"])
    same = case["plant"] == case["simulator"]
    known = len(truth) == size and truth <= set(EFFECTS)
    return known and same == own and bool(entry["hypotheses"])


def _cells(entries: Sequence[Mapping[str, Any]], size: int) -> list[str]:
    """Number of cases, fitted ones, exact ones."""
    fitted = sum(0 < e["rank"] <= FITTED[size] for e in entries) if size else 0
    exact = sum(most_evident(e) == sorted(e["case"]["concealed"]) for e in entries)
    return [str(len(entries)), str(fitted) if size else "-", str(exact)]
