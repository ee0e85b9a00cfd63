"""Tables in Markdown of what is named in cases that were searched."""

from collections.abc import Mapping, Sequence

from buggy_rl.diagnosis.search.posterior import EVEN, LISTED, Posterior
from buggy_rl.proof.ledger import Entry
from buggy_rl.proof.score.figures import cell, share
from buggy_rl.proof.score.outcome import ScoredCase
from buggy_rl.proof.score.rivals import McNemar
from buggy_rl.proof.score.score import (
    calibration_error,
    debiased_calibration_error,
    searched_rows,
)


def lowest_loss(entry: Entry) -> Posterior:
    """Posterior all on the hypothesis of lowest held-out loss, as named without calibration."""
    best = min(entry.seen.fitted, key=lambda h: h.loss)
    return Posterior({best.effects: 1.0}, 0.0)


def best_single(entry: Entry) -> Posterior:
    """Posterior all on the effect, or none, of lowest held-out loss of those fitted alone."""
    alone = [h for h in entry.seen.fitted if len(h.effects) < 2]
    return Posterior({min(alone, key=lambda h: h.loss).effects: 1.0}, 0.0)


def counted(methods: Mapping[str, Sequence[ScoredCase]]) -> str:
    """A column for each method: share, interval and number of cases."""
    lines = [f"| | {' | '.join(methods)} |", f"|---|{'---|' * len(methods)}"]
    columns = [_column(scored) for scored in methods.values()]
    for name in columns[0]:
        lines.append(f"| {name} | {' | '.join(column[name] for column in columns)} |")
    return "\n".join(lines)


def _column(scored: Sequence[ScoredCase]) -> dict[str, str]:
    claims = [claim for o in scored for claim in listed(o)]
    standing = [name in o.case.truth for o in scored for name in o.answer.standing]
    squares = [(p - right) ** 2 for p, right in claims]
    return {
        **{row.name: cell(row.figure) for row in searched_rows(scored)},
        "names above 0.5 that are right": cell(share([right for p, right in claims if p > EVEN])),
        "called unknown: a name that holds whatever else is missing, right": cell(share(standing)),
        "Brier score of all listed names": f"{sum(squares) / max(1, len(squares)):.3f}",
        "expected calibration error": f"{calibration_error(claims):.3f} ({len(claims)} names)",
        "debiased": f"{debiased_calibration_error(claims):.3f}",
    }


def listed(o: ScoredCase) -> list[tuple[float, bool]]:
    """Probability of each effect that has any, and whether it is concealed."""
    return [(p, e in o.case.truth) for e, p in o.answer.probable.items() if p >= LISTED]


def mcnemar(ours: Sequence[ScoredCase], theirs: Sequence[ScoredCase], name: str) -> str:
    """How many answers of two methods are exactly right, and the test of their difference."""
    right, its = ([o.all_right for o in scored] for scored in (ours, theirs))
    test = McNemar.of(right, its)
    return (
        f"Exactly right: {sum(right)} by the posterior, {sum(its)} by {name}; only one of both "
        f"{test.wins} : {test.losses} (McNemar's exact test, p = {test.p:.2g})"
    )


def fitted_counts(entries: Sequence[Entry]) -> str:
    """Cases, and those whose true set was fitted without being asked for.

    By how many effects are concealed, and whether the simulator is of the plant's make; cases with
    physics that no effect describes are not in it, nor those that failed.
    """
    lines = [
        "| concealed | of the plant's make | fitted | of another make | fitted |",
        "|---|--:|--:|--:|--:|",
    ]
    for family in ("one", "two", "three"):
        cells = [family]
        for own in (True, False):
            among = [
                entry
                for entry in entries
                if entry.evidence and (entry.case.family, entry.case.own_make) == (family, own)
            ]
            fitted = [e.case.truth in {h.effects for h in e.seen.fitted} for e in among]
            cells += [str(len(fitted)), str(sum(fitted))]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def by_pairing(scored: Sequence[ScoredCase]) -> str:
    """Exactly right of how many, and names where no effect is missing."""
    lines = [
        "| car -> simulator | one effect | two, three | no effect describes it | nothing | "
        "a name above 0.5 where no effect is missing |",
        "|---|--:|--:|--:|--:|--:|",
    ]
    for name in sorted({o.case.pairing for o in scored}):
        own = [o for o in scored if o.case.pairing == name]
        cells = [
            _of([o.all_right for o in own if o.case.family in families])
            for families in (("one",), ("two", "three"), ("unknown",), ("nothing",))
        ]
        none = [bool(o.answer.likely) for o in own if o.case.unknown or not o.case.truth]
        lines.append(f"| {name} | {' | '.join([*cells, _of(none)])} |")
    return "\n".join(lines)


def _of(hits: Sequence[bool]) -> str:
    return f"{sum(hits)} of {len(hits)}" if hits else ""
