"""What a posterior names, by pairing of car and simulator."""

from collections.abc import Sequence

from buggy_rl.blind_test.calibration import outside, truth, unknown
from buggy_rl.blind_test.case import Case
from buggy_rl.blind_test.compared import right
from buggy_rl.blind_test.named import Answered, Entry, says_a_name
from buggy_rl.blind_test.statistics import share


def by_pairing(entries: Sequence[Entry], found: Sequence[Answered]) -> str:
    """A table in Markdown: exactly right of how many, and names where no effect is missing."""
    lines = [
        "| car -> simulator | one effect | two, three | no effect describes it | nothing | "
        "a name above 0.5 where no effect is missing |",
        "|---|--:|--:|--:|--:|--:|",
    ]
    said = list(zip(entries, found, strict=True))
    pairing = {id(entry): Case(**entry["case"]).pairing for entry in entries}
    for name in sorted(set(pairing.values())):
        own = [s for s in said if pairing[id(s[0])] == name]
        kinds = (
            [s for s in own if not outside(s[0]) and len(truth(s[0])) == 1],
            [s for s in own if len(truth(s[0])) > 1],
            [s for s in own if outside(s[0])],
            [s for s in own if not truth(s[0])],
        )
        cells = [_of([right(*s) for s in kind]) for kind in kinds]
        none = [says_a_name(*s) for s in own if unknown(s[0]) or not truth(s[0])]
        lines.append(f"| {name} | {' | '.join([*cells, _of(none)])} |")
    return "\n".join(lines)


def _of(hits: Sequence[bool]) -> str:
    figure = share(hits)
    return f"{sum(hits)} of {figure.count}" if figure.count else ""
