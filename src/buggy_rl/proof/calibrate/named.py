"""What a posterior names, counted over development cases."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from scipy.stats import binomtest

from buggy_rl.diagnosis.search.candidate import Effects
from buggy_rl.diagnosis.search.case_evidence import CaseEvidence
from buggy_rl.diagnosis.search.posterior import EVEN, LISTED, Posterior, certainly_missing
from buggy_rl.effects import offered
from buggy_rl.proof.calibrate.calibration import (
    Entry,
    differs_unseen,
    meant,
    of_another_form,
    outside,
    truth,
    unknown,
)
from buggy_rl.proof.cases.case import COMMANDS, Case
from buggy_rl.proof.score.score import (
    Figure,
    calibration_error,
    debiased_calibration_error,
    share,
)


class Answered(Protocol):
    """What is counted of an answer; a `Posterior` is one."""

    @property
    def sets(self) -> Mapping[Effects, float]:
        """Sets of effects that are mentioned."""
        ...

    @property
    def best(self) -> Effects:
        """The set that is named."""
        ...

    @property
    def says(self) -> str:
        """nothing, unknown, or effects."""
        ...

    def of(self, effect: str) -> float:
        """Probability that an effect is missing."""
        ...

    def whatever_else(self, effect: str) -> float:
        """Probability that an effect is missing if effects are missing at all."""
        ...


Said = Sequence[tuple[Entry, Answered]]


def lowest_loss(entry: Entry) -> Posterior:
    """Posterior all on the hypothesis of lowest held-out loss, as named without calibration."""
    best = min(CaseEvidence.from_dict(entry).fitted, key=lambda h: h.loss)
    return Posterior({best.effects: 1.0}, 0.0)


def best_single(entry: Entry) -> Posterior:
    """Posterior all on the effect, or none, of lowest held-out loss of those fitted alone."""
    alone = [h for h in CaseEvidence.from_dict(entry).fitted if len(h.effects) < 2]
    return Posterior({min(alone, key=lambda h: h.loss).effects: 1.0}, 0.0)


def counted(entries: Sequence[Entry], methods: Mapping[str, Sequence[Answered]]) -> str:
    """A table in Markdown, a column for each method: share, interval and number of cases."""
    lines = [f"| | {' | '.join(methods)} |", f"|---|{'---|' * len(methods)}"]
    columns = [_figures(list(zip(entries, found, strict=True))) for found in methods.values()]
    for name in columns[0]:
        lines.append(f"| {name} | {' | '.join(column[name] for column in columns)} |")
    return "\n".join(lines)


def _figures(said: Said) -> dict[str, str]:
    of = {n: [s for s in said if not unknown(s[0]) and len(truth(s[0])) == n] for n in range(4)}
    sorts = [s for s in said if outside(s[0])]
    forms = [s for s in said if of_another_form(s[0])]
    unseen = [s for s in of[1] if differs_unseen(s[0])]
    claims = [c for entry, p in said for c in listed(entry, p)]
    figures = {
        "one effect: first name right": _share(of[1], _first_right),
        "one effect: and nothing else said": _share(of[1], _exact),
        "two effects: exact set": _share(of[2], _exact),
        "three effects: exact set": _share(of[3], _exact),
        "true set fitted (one, two, three)": _share(of[1] + of[2] + of[3], _came_to),
        "nothing: a name above 0.5": _share(of[0], says_a_name),
        "no effect describes it: a name above 0.5": _share(sorts, says_a_name),
        "no effect describes it: called unknown": _share(sorts, _says_unknown),
        "no effect describes it: called nothing": _share(sorts, _says_nothing),
        "another form, no baseline, nothing concealed: a name above 0.5": _share(
            forms, says_a_name
        ),
        "another form, no baseline, nothing concealed: called unknown": _share(
            forms, _says_unknown
        ),
    }
    figures["another form, no baseline, one effect: most probable name right"] = _share(
        unseen, _most_probable_right
    )
    figures["another form, no baseline, one effect: a wrong name above 0.5"] = _share(
        unseen, _says_a_wrong_name
    )
    figures["one effect, all others: first name right"] = _share(
        [s for s in of[1] if not differs_unseen(s[0])], _first_right
    )
    standing = [c for entry, p in said for c in _standing(entry, p)]
    figures["called unknown: a name that holds whatever else is missing, right"] = share(standing)
    squares = [(p - right) ** 2 for p, right in claims]
    return {
        **{name: _cell(figure) for name, figure in figures.items()},
        "Brier score of all listed names": f"{sum(squares) / max(1, len(squares)):.3f}",
        "expected calibration error": f"{calibration_error(claims):.3f} ({len(claims)} names)",
        "debiased": f"{debiased_calibration_error(claims):.3f}",
    }


def sure(p: Answered) -> dict[str, float]:
    """Probability of each effect; that of a parameter that is the same is added to it."""
    total: dict[str, float] = {}
    for effect in sorted({e for effects in p.sets for e in effects}):
        [name] = meant([effect])
        total[name] = min(1.0, total.get(name, 0.0) + p.of(effect))
    return total


def listed(entry: Entry, p: Answered) -> list[tuple[float, bool]]:
    """Probability of each effect that has any, and whether it is concealed."""
    return [(s, e in truth(entry)) for e, s in sure(p).items() if s >= LISTED]


def _standing(entry: Entry, p: Answered) -> list[bool]:
    """Whether each effect is concealed that an answer says holds whatever else is missing."""
    if p.says != "unknown":
        return []
    named = [e for e in p.best if certainly_missing(p.whatever_else(e), p.of(e))]
    return [name in truth(entry) for name in meant(named)]


def _came_to(entry: Entry, p: Answered) -> bool:
    del p
    return truth(entry) in {meant(h.effects) for h in CaseEvidence.from_dict(entry).fitted}


def _most_probable_right(entry: Entry, p: Answered) -> bool:
    probable = sure(p)
    return (max(probable, key=lambda e: probable[e], default=""),) == truth(entry)


def _first_right(entry: Entry, p: Answered) -> bool:
    return _most_probable_right(entry, p) and p.says not in ("nothing", "unknown")


def _says_a_wrong_name(entry: Entry, p: Answered) -> bool:
    return any(s > EVEN and e not in truth(entry) for e, s in sure(p).items())


def _exact(entry: Entry, p: Answered) -> bool:
    return meant(p.best) == truth(entry) and p.says == "effects"


def says_a_name(entry: Entry, p: Answered) -> bool:
    """Whether an effect has more than half of the probability."""
    del entry
    return any(s > EVEN for s in sure(p).values())


def _says_unknown(entry: Entry, p: Answered) -> bool:
    del entry
    return p.says == "unknown"


def _says_nothing(entry: Entry, p: Answered) -> bool:
    del entry
    return p.says == "nothing"


def _share(said: Said, hit: Callable[[Entry, Answered], bool]) -> Figure:
    return share([hit(entry, p) for entry, p in said])


def _cell(figure: Figure) -> str:
    if not figure.count:
        return "no cases"
    interval = f"{100 * figure.low:.0f} to {100 * figure.high:.0f}"
    return f"{100 * figure.value:.0f} % ({interval}) of {figure.count}"


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


WORDS = {1: "one", 2: "two", 3: "three"}


def fitted_counts(entries: Sequence[Mapping[str, Any]]) -> str:
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
