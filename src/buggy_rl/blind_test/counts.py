"""How often a joint search comes to the true set by itself, counted over development cases."""

from collections.abc import Mapping, Sequence
from typing import Any

from buggy_rl.blind_test.case import COMMANDS
from buggy_rl.diagnosis.case_evidence import CaseEvidence
from buggy_rl.effects import offered

WORDS = {1: "one", 2: "two", 3: "three"}


def counts(entries: Sequence[Mapping[str, Any]]) -> str:
    """A table in Markdown: cases, and those whose true set was fitted without being asked for.

    By how many effects are concealed, and whether the simulator is of the plant's make; cases with
    physics that no effect describes are not in it, nor those that failed.
    """
    lines = [
        "| concealed | of the plant's make | fitted | of another make | fitted |",
        "|---|--:|--:|--:|--:|",
    ]
    for size, word in WORDS.items():
        cells = [word]
        for own in (True, False):
            cells += _cells([e for e in entries if _is(e, size, own)])
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _is(entry: Mapping[str, Any], size: int, own: bool) -> bool:
    case, truth = entry["case"], set(entry["case"]["concealed"])
    same = case["plant"] == case["simulator"]
    known = offered(COMMANDS[case.get("command", "throttle")])
    named = len(truth) == size and truth <= set(known)
    return named and same == own and bool(entry["hypotheses"])


def _cells(entries: Sequence[Mapping[str, Any]]) -> list[str]:
    right = [
        tuple(sorted(e["case"]["concealed"]))
        in {h.effects for h in CaseEvidence.from_dict(e).fitted}
        for e in entries
    ]
    return [str(len(entries)), str(sum(right))]
