"""Two methods on the same development cases: which of them is exactly right more often."""

from collections.abc import Sequence

from scipy.stats import binomtest

from buggy_rl.blind_test.calibration import Entry, meant, truth, unknown
from buggy_rl.blind_test.named import Answered


def right(entry: Entry, said: Answered) -> bool:
    """Whether exactly what is missing is said: the set, nothing, or unknown physics."""
    if unknown(entry):
        return said.says == "unknown"
    if not truth(entry):
        return said.says == "nothing"
    return said.says == "effects" and meant(said.best) == truth(entry)


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
