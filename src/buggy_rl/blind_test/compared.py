"""Two methods on the same development cases: their tables, and which of them is right more often.

The other method's answers are a JSON Lines file of `seed`, `verdict` and `named`, a confidence for
each effect.
"""

import json
from collections.abc import Sequence
from pathlib import Path

from scipy.stats import binomtest

from buggy_rl.blind_test.calibration import Entry, meant, truth, unknown
from buggy_rl.blind_test.named import Answered, Claimed, counted


def right(entry: Entry, said: Answered) -> bool:
    """Whether exactly what is missing is said: the set, nothing, or unknown physics."""
    if unknown(entry):
        return said.says == "unknown"
    if not truth(entry):
        return said.says == "nothing"
    return said.says == "effects" and meant(said.best) == truth(entry)


def compared(entries: Sequence[Entry], found: Sequence[Answered], file: Path) -> str:
    """Tables of both over the cases that both have answered, and McNemar's exact test."""
    lines = [json.loads(line) for line in file.read_text().splitlines()]
    others = {line["seed"]: Claimed(line["verdict"], line["named"]) for line in lines}
    both = [
        (entry, own, others[entry["case"]["seed"]])
        for entry, own in zip(entries, found, strict=True)
        if entry["case"]["seed"] in others
    ]
    cases = [entry for entry, _, _ in both]
    ours = [own for _, own, _ in both]
    theirs = [other for _, _, other in both]
    table = counted(cases, {"posterior": ours, file.stem: theirs})
    tested = mcnemar(cases, ours, theirs, file.stem)
    return f"{len(both)} cases that both have answered:\n\n{table}\n\n{tested}"


def mcnemar(
    entries: Sequence[Entry], ours: Sequence[Answered], theirs: Sequence[Answered], name: str
) -> str:
    """How many answers of two methods are exactly right, and the test of their difference."""
    pairs = [
        (right(entry, own), right(entry, other))
        for entry, own, other in zip(entries, ours, theirs, strict=True)
    ]
    only = [sum(a and not b for a, b in pairs), sum(b and not a for a, b in pairs)]
    chance = binomtest(only[0], sum(only)).pvalue if any(only) else 1.0
    return (
        f"Exactly right: {sum(a for a, _ in pairs)} by the posterior, "
        f"{sum(b for _, b in pairs)} by {name}; only one of both "
        f"{only[0]} : {only[1]} (McNemar's exact test, p = {chance:.2g})"
    )
