"""How often each effect was identified in the published sealed sets: the README's columns.

    python benchmarks/identified.py
    python benchmarks/identified.py runs/again/ledger.jsonl

Counts cases in which exactly one effect was concealed. It was identified where the diagnosis named
it first, by its name or as the simulator's own parameter that it is, and the verdict was not
unknown_physics. Prints one row an effect, one column a ledger, as Markdown.
"""

import sys
from pathlib import Path

PROOF = Path(__file__).parents[1] / "docs" / "proof"
PUBLISHED = tuple(PROOF / name / "ledger.jsonl" for name in ("second", "first"))


def main() -> None:
    """Prints the table of the given ledgers, or of the published ones."""
    if {"-h", "--help"} & set(sys.argv):
        raise SystemExit((__doc__ or "").strip())
    files = [Path(argument) for argument in sys.argv[1:]] or list(PUBLISHED)
    missing = [str(file) for file in files if not file.is_file()]
    if missing:
        raise SystemExit(f"error: no ledger {', '.join(missing)}")

    from buggy_rl.effects import EFFECTS

    columns = [identified(file) for file in files]
    print(f"| effect | {' | '.join(file.parent.name for file in files)} |")
    print("|---" * (1 + len(files)) + "|")
    for name in EFFECTS:
        print(f"| `{name}` | {' | '.join(c.get(name, 'not drawn') for c in columns)} |")


def identified(file: Path) -> dict[str, str]:
    """Effect -> "3 of 4", of the single effects of a ledger."""
    from buggy_rl.blind_test.ledger import Ledger
    from buggy_rl.blind_test.outcome import OURS

    outcomes = [entry[OURS] for entry in Ledger(file).entries().values()]
    right: dict[str, list[bool]] = {}
    for outcome in outcomes:
        if outcome.case.family == "one":
            right.setdefault(outcome.case.truth[0], []).append(outcome.right)
    return {name: f"{sum(found)} of {len(found)}" for name, found in right.items()}


if __name__ == "__main__":
    main()
