"""Why an answer is not what one could ask for, in a few words."""

from buggy_rl.blind_test.names import meant
from buggy_rl.blind_test.outcome import Outcome


def reason(o: Outcome) -> str:
    """What went wrong with an answer that did not pass, told from what was said and weighed."""
    if o.status != "answered":
        return "no answer"
    if o.case.family == "nothing":
        return "a name for nothing" if o.said else "nothing is there, and it is not known what"
    if o.case.family == "unknown":
        return _outside(o)
    return "; ".join([*_undecidable(o), *_missed(o)])


def _outside(o: Outcome) -> str:
    """Of what no entry of the library describes."""
    if o.verdict == "no_mismatch":
        return "not seen"
    return "taken for what the library has" if o.sure_and_wrong else "named, though not surely"


def _undecidable(o: Outcome) -> list[str]:
    if o.failed:
        return ["not weighed"]
    if o.decidable is not False:
        return []
    if o.case.family != "one":
        return ["one of them hardly shows in these drives"]
    return ["another cause does as well on these drives"]


def _missed(o: Outcome) -> list[str]:
    """Of what the library has."""
    if not o.said:
        return ["not seen" if o.verdict == "no_mismatch" else "no name earned its place"]
    truth = set(o.case.truth)
    rivals = {meant(name) for said in o.said for name in said.rivals}
    found = [f"{name} stands as a rival" for name in sorted((truth - o.names) & rivals)]
    found += [f"{name} is not named" for name in sorted(truth - o.names - rivals)]
    found += [f"{name} is not there" for name in sorted(o.names - truth)]
    if o.verdict == "unknown_physics":
        found.append("called unknown")
    # Only a single effect's order matters; of several the set does.
    if not found:
        found.append("the right name does not come first")
    return found
