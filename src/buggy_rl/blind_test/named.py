"""What a posterior names, counted over development cases."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from buggy_rl.blind_test.calibration import (
    differs_unseen,
    meant,
    of_another_form,
    outside,
    truth,
    unknown,
)
from buggy_rl.blind_test.statistics import (
    Figure,
    calibration_error,
    debiased_calibration_error,
    share,
)
from buggy_rl.diagnosis.candidate import Effects
from buggy_rl.diagnosis.case_evidence import CaseEvidence
from buggy_rl.diagnosis.posterior import EVEN, LISTED, Posterior, stands

Entry = Mapping[str, Any]


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
        """That it is if effects are missing at all."""
        ...


Said = Sequence[tuple[Entry, Answered]]


def lowest_loss(entry: Entry) -> Posterior:
    """All on the hypothesis with the lowest held-out loss: what is named without calibration."""
    best = min(CaseEvidence.from_dict(entry).fitted, key=lambda h: h.loss)
    return Posterior({best.effects: 1.0}, 0.0)


def best_single(entry: Entry) -> Posterior:
    """All on the effect, or none, with the lowest held-out loss of those fitted alone."""
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
    named = [e for e in p.best if stands(p.whatever_else(e), p.of(e))]
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
