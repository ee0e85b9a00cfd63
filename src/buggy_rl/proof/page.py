"""The page that shows a score, as Markdown, and why a case is among the failing ones."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Picture

from buggy_rl.core.files import write_atomically
from buggy_rl.figures.style import COLOURS, FAINT, tidy
from buggy_rl.proof.cases.case import DRIVING, NUISANCES
from buggy_rl.proof.cases.equivalents import meant
from buggy_rl.proof.ledger import OURS
from buggy_rl.proof.markdown import page_of, table
from buggy_rl.proof.proof import ProofConfig
from buggy_rl.proof.score.answers import (
    MoreRow,
    StackRow,
    StrengthRow,
    WeighedAnswer,
    answer_rows,
    more_by_difference,
    named_curve,
    stack_by_family,
)
from buggy_rl.proof.score.figures import Figure, ScoreRow, written
from buggy_rl.proof.score.outcome import ScoredCase
from buggy_rl.proof.score.rivals import ABLE, ALL, MethodComparison
from buggy_rl.proof.score.score import Score
from buggy_rl.proof.score.strength import STRENGTHS

GOOD, BAD = COLOURS[1], COLOURS[0]


def pictures(score: Score, answers: Sequence[WeighedAnswer] = ()) -> dict[str, Picture]:
    """Pictures by the end of their file's name; those without a case are left out."""
    found: dict[str, Picture] = {}
    if answers:
        found["strength"] = strength_curve(named_curve(answers, STRENGTHS))
    found |= {"figures": targets(score.rows), "classes": classes(score.breakdown)}
    if score.calibration:
        found["confidence"] = _confidence(score)
    if score.confusion:
        found["confusion"] = confusion(score.confusion)
    return found


def strength_curve(curve: Sequence[StrengthRow]) -> Picture:
    """Share of effects that are named, and of names that are right, by the effects' strength."""
    picture, axis = plt.subplots(figsize=(7, 2.7), constrained_layout=True)
    places = np.arange(len(curve), dtype=float)
    for own, (label, colour) in enumerate(
        (("effects that are named (recall)", GOOD), ("names that are right (precision)", BAD))
    ):
        figures = [row.precision if own else row.recall for row in curve]
        value, low, high = (
            100 * np.array([getattr(f, end) for f in figures]) for end in ("value", "low", "high")
        )
        beside = places + 0.12 * (own - 0.5)
        axis.vlines(beside, low, high, color=colour, lw=3, alpha=0.4)
        axis.plot(beside, value, "o-", color=colour, ms=5, lw=1, label=label)
    axis.set_xticks(places, [_label(row) for row in curve])
    axis.set(xlabel="strength of at least so many nats", ylabel="%", ylim=(-3, 103))
    axis.legend(frameon=False, loc="lower right", fontsize=8)
    tidy(axis)
    return picture


def _label(row: StrengthRow) -> str:
    """Least strength of a row, in words."""
    return "any" if np.isinf(row.least) else f"{row.least:g}"


def targets(rows: Sequence[ScoreRow]) -> Picture:
    """Every share with its interval, and the target where there is one."""
    shown = [row for row in rows if row.figure.count and row.percent and row.figure.value <= 1.5]
    picture, axis = plt.subplots(figsize=(8.5, 0.26 * len(shown) + 1), constrained_layout=True)
    for place, row in enumerate(reversed(shown)):
        colour = FAINT if row.met is None else GOOD if row.met else BAD
        _interval(axis, row.figure, place, colour)
        if row.target is not None:
            axis.plot(100 * row.target, place, "|", color="black", ms=13, mew=1.5)
    labels = [row.name.replace("  ", "– ") for row in reversed(shown)]
    axis.set_yticks(range(len(shown)), labels, fontsize=8)
    axis.set_ylim(-0.7, len(shown) - 0.3)
    axis.set_xlabel("% of the cases, with 95 % intervals; | is the target")
    tidy(axis)
    return picture


def classes(breakdown: Mapping[str, Mapping[str, Figure]]) -> Picture:
    """Share of right first names of single effects, class by class."""
    shown = {name: rows for name, rows in breakdown.items() if rows}
    wide = "effect"
    others = [name for name in shown if name != wide]
    picture = plt.figure(figsize=(11, 9), constrained_layout=True)
    if not shown:
        return picture
    heights = [max(2, len(shown[name])) for name in others]
    grid = picture.add_gridspec(len(others), 2, height_ratios=heights)
    _bars(picture.add_subplot(grid[:, 0]), wide, shown[wide])
    for place, name in enumerate(others):
        _bars(picture.add_subplot(grid[place, 1]), name, shown[name])
    return picture


def _confidence(score: Score) -> Picture:
    """How often a claim of some confidence is right, and what is gained by being choosy."""
    picture, (left, right) = plt.subplots(1, 2, figsize=(9, 4), constrained_layout=True)
    said, right_share, count = zip(*score.calibration, strict=True)
    left.plot([0, 1], [0, 1], color=FAINT, lw=1)
    left.scatter(said, right_share, s=[12 + 6 * n for n in count], color=GOOD, alpha=0.8)
    left.set_xlabel("confidence said")
    left.set_ylabel("share that is right")
    answered, accurate = zip(*score.coverage, strict=True)
    right.step(answered, accurate, where="post", color=GOOD)
    right.set_xlabel("share answered, the surest first")
    right.set_ylabel("share of those that is right")
    for axis in (left, right):
        axis.set(xlim=(-0.02, 1.02), ylim=(-0.02, 1.04))
        tidy(axis)
    return picture


def confusion(counts: Mapping[str, Mapping[str, int]]) -> Picture:
    """What was true, downwards, against what was said first."""
    true = list(counts)
    found = {said for row in counts.values() for said in row}
    said = [*(name for name in true if name in found), *sorted(found - set(true))]
    table = np.array([[counts[t].get(s, 0) for s in said] for t in true], dtype=float)
    share = table / table.sum(1, keepdims=True)
    size = (0.26 * len(said) + 3, 0.26 * len(true) + 2.5)
    picture, axis = plt.subplots(figsize=size, constrained_layout=True)
    axis.imshow(share, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    for (row, column), count in np.ndenumerate(table):
        if count:
            colour = "white" if share[row, column] > 0.5 else "black"
            axis.text(
                column, row, f"{count:.0f}", ha="center", va="center", color=colour, fontsize=7
            )
    axis.set_xticks(range(len(said)), said, rotation=90, fontsize=7)
    axis.set_yticks(range(len(true)), true, fontsize=7)
    axis.set_xlabel("said first")
    axis.set_ylabel("concealed")
    return picture


def _bars(axis: Axes, name: str, rows: Mapping[str, Figure]) -> None:
    for place, figure in enumerate(reversed(list(rows.values()))):
        _interval(axis, figure, place, GOOD)
    labels = [f"{label} ({figure.count})" for label, figure in rows.items()]
    axis.set_yticks(range(len(rows)), labels[::-1], fontsize=7)
    axis.set_title(f"first name right, by {name} [%]", fontsize=9, loc="left")
    axis.set(xlim=(-3, 103), ylim=(-0.7, len(rows) - 0.3))
    axis.tick_params(axis="x", labelsize=7)
    tidy(axis)


def _interval(axis: Axes, figure: Figure, place: int, colour: str) -> None:
    low, value, high = (100 * v for v in (figure.low, figure.value, figure.high))
    axis.plot([low, high], [place, place], color=colour, lw=3, alpha=0.4)
    axis.plot(value, place, "o", color=colour, ms=5)


MEASURED = ("figure", "target", "measured", "n")
OVER_STRENGTH = (
    *("strength of at least [nats]", "effects that are named", "n"),
    *("names that are right", "n"),
)
STACKS = (
    *("concealed", "closed", "by re-tuning alone", "by a learned residual alone", "n"),
    "something simpler is surely nearer",
)
MORE = ("differs beside the effects", "said above four fifths", "below one fifth", "n")
WRONG = ("case", "pairing", "concealed", "its strength [nats]", "wrong", "right beside it")
RIVALS = (
    *("method", "cases", "n", "its right", "ours right", "only ours : only its", "p"),
    *("by names given", "only ours : only its", "p", "crashed"),
)
BESIDE_OTHERS = ("method", "all cases", "p", "that it can represent", "p", "by names given", "p")
LOST = ("case", "pairing", "concealed", "said", "by names given", "right alone")
CAPTIONS = {
    "strength": "Names over the strength of what is concealed",
    "figures": "Every share with its interval",
    "classes": "First names by effect, pairing, nuisance, size, length and driving",
    "confidence": "Calibration, and accuracy against coverage",
    "confusion": "What was concealed against what was said first",
}


def proof_page(
    config: ProofConfig,
    scores: Mapping[str, Score],
    compared: Sequence[MethodComparison],
    command: str,
    opened: int,
    images: Mapping[str, str],
    answers: Sequence[WeighedAnswer] = (),
    made: Sequence[str] = (),
) -> str:
    """The whole page.

    Args:
        config: Of the run.
        scores: By method; those of the diagnosis under `OURS`.
        compared: The diagnosis and other methods on the same cases.
        command: That makes the page again.
        opened: How often the sealed cases were scored.
        images: Kind of picture -> its path from the page.
        answers: Of the diagnosis, beside what could be found.
        made: When and by which code, in words.
    """
    own = scores[OURS]
    return page_of(
        "buggy_rl.proof",
        "page.md.jinja",
        written=written,
        command=command,
        split=config.draw.split,
        opened=opened,
        made="; ".join(made),
        images=images,
        captions=CAPTIONS,
        score=own,
        others=[name for name in scores if name != OURS],
        figures=_figures(scores),
        tables=page_tables(answers, compared),
        nuisances=NUISANCES,
        driving=DRIVING,
        single=[_single(o) for o in sorted(own.single, key=lambda o: (o.case.truth, o.case.seed))],
        failing=[_failing(o) for o in own.failing],
    )


def page_tables(
    answers: Sequence[WeighedAnswer],
    compared: Sequence[MethodComparison],
    made: Sequence[str] = (),
) -> dict[str, str]:
    """Tables that other pages may have too, by name; those of nothing are left out."""
    found = {}
    if answers:
        found["counted"] = "; ".join((f"{len(answers)} cases", *made)) + "."
        rows = answer_rows(answers)
        found["answers"] = table(MEASURED, map(figure_cells, rows))
        found["targets"] = table(
            MEASURED, (figure_cells(row) for row in rows if row.target is not None)
        )
        found["strength"] = table(
            OVER_STRENGTH, map(strength_cells, named_curve(answers, STRENGTHS))
        )
        found["stacks"] = table(STACKS, map(_stack, stack_by_family(answers)))
        found["more"] = table(MORE, map(_more, more_by_difference(answers)))
        wrong = [_wrong(a) for a in answers if a.wrong]
        found["wrong"] = table(WRONG, wrong) if wrong else "None."
        found["misnamed"] = _misnamed(answers)
    if compared:
        found["rivals"] = table(RIVALS, map(_compared, compared))
        found["methods"] = table(BESIDE_OTHERS, _method_rows(compared))
        able = [c for c in compared if c.which == ABLE]
        lost = _lost(able)
        found["lost"] = table(LOST, lost) if lost else "None."
        found["beside"] = _named_in_lost(able)
    return found


def write_page(
    config: ProofConfig,
    scores: Mapping[str, Score],
    compared: Sequence[MethodComparison],
    command: str,
    opened: int,
    answers: Sequence[WeighedAnswer] = (),
    made: Sequence[str] = (),
) -> Path:
    """Writes the page and its pictures to the files of the config; the page's path."""
    file = Path(config.page or config.store.output / "proof.md")
    folder = Path(config.images or file.parent)
    folder.mkdir(parents=True, exist_ok=True)
    images = {}
    for kind, picture in pictures(scores[OURS], answers).items():
        image = folder / f"{file.stem}_{kind}.png"
        picture.savefig(image, dpi=130)
        images[kind] = os.path.relpath(image, file.parent)
    text = proof_page(config, scores, compared, command, opened, images, answers, made)
    write_atomically(file, text)
    return file


def _figures(scores: Mapping[str, Score]) -> list[list[str]]:
    """A row for each figure: its target, the measured value, the cases, and other methods'."""
    others = [
        {row.name: written(row.figure, row.percent) for row in score.rows}
        for name, score in scores.items()
        if name != OURS
    ]
    return [
        [*figure_cells(row), *(other.get(row.name, "") for other in others)]
        for row in scores[OURS].rows
    ]


def figure_cells(row: ScoreRow) -> list[str]:
    """A figure, its target, the measured value and the cases."""
    measured = written(row.figure, row.percent)
    return [
        indented(row.name),
        _target(row),
        f"**{measured}**" if row.met is False else measured,
        str(row.figure.count),
    ]


def indented(name: str) -> str:
    """Name of a figure; an indent shows that it is a part of the one above."""
    return name.replace("  ", "– ", 1) if name.startswith("  ") else name


def strength_cells(row: StrengthRow) -> list[str]:
    """Cells of a row: least strength, and both shares with their cases."""
    both = (row.recall, row.precision)
    return [_label(row), *(text for f in both for text in (written(f), str(f.count)))]


def _stack(row: StackRow) -> list[str]:
    """Cells of a row: the gap closed, by what is simpler too, and how often that is nearer."""
    shares = (row.closed, row.retuned, row.residual)
    beaten = f"{round(row.beaten.value * row.beaten.count)} of {row.beaten.count}"
    return [row.family, *(written(f) for f in shares), str(row.closed.count), beaten]


def _more(row: MoreRow) -> list[str]:
    """Cells of what is said of more that is missing, in cases of one kind."""
    return [row.kind, written(row.surely), written(row.hardly), str(row.surely.count)]


def _wrong(a: WeighedAnswer) -> list[str]:
    """An answer with a wrong name above one half, beside what is concealed."""
    case, said = a.scored.case, a.scored.answer.said
    true = "; ".join(f"{effect} {_numbers(v)}" for effect, v in case.concealed.items())
    sure = {s.effect: s for s in said if s.effect in a.given}
    wrong = (f"{n} {_numbers(sure[n].values, '.3g')} ({sure[n].confidence:.2f})" for n in a.wrong)
    right = (f"{n} ({sure[n].confidence:.2f})" for n in a.given if n in case.truth)
    nats = (f"{n} {nats:.0f}" for n, nats in a.strength.items())
    made = (case.id, case.pairing, true or "nothing", ", ".join(nats))
    return [*made, "; ".join(wrong), "; ".join(right)]


def _misnamed(answers: Sequence[WeighedAnswer]) -> str:
    """How many cases have a wrong name above one half, by what is concealed."""
    wrong = [a.family for a in answers if a.wrong]
    grammar, outside = wrong.count("term"), wrong.count("unknown")
    return (
        f"Of {len(answers)} cases, {len(wrong)} have a wrong name above one half: "
        f"{len(wrong) - grammar - outside} in which effects or nothing are concealed, "
        f"{grammar} with an equation of the grammar, {outside} with what is outside of both."
    )


def _named_in_lost(compared: Sequence[MethodComparison]) -> str:
    """Cases that each method alone has, and how many of them are named rightly all the same."""
    lost = (
        f"{c.method} {len(c.lost)} ({sum(o.given_right for o in c.lost)})"
        for c in compared
        if c.lost
    )
    return (
        "Cases that a method alone has exactly right, of those that it can represent, and of how "
        f"many of these the names above one half are right: {', '.join(lost) or 'none'}."
    )


def _compared(c: MethodComparison) -> list[str]:
    right, given = (
        [str(count), f"{test.wins} : {test.losses}", f"{test.p:.2g}"]
        for count, test in ((c.ours, c.test), (c.given, c.given_test))
    )
    return [c.method, c.which, str(c.cases), str(c.theirs), *right, *given, str(c.crashed)]


def _method_rows(compared: Sequence[MethodComparison]) -> list[list[str]]:
    """A row for each method: only the diagnosis right : only the method, and McNemar's p."""
    whole = {c.method: c for c in compared if c.which == ALL}
    rows = []
    for able in (c for c in compared if c.which == ABLE):
        tests = (whole[able.method].test, able.test, able.given_test)
        cells = ((f"{t.wins} : {t.losses}", f"{t.p:.2g}") for t in tests)
        rows.append([f"{able.method} ({able.cases})", *(text for pair in cells for text in pair)])
    return rows


def _lost(compared: Sequence[MethodComparison]) -> list[list[str]]:
    """A row for each case that a method alone has: what was concealed, what was said, by whom."""
    cases = {o.case.id: o for c in compared for o in c.lost}
    rows = []
    for case, o in sorted(cases.items()):
        true, given = "; ".join(o.case.truth) or "nothing", "right" if o.given_right else ""
        methods = (c.method for c in compared if case in {lost.case.id for lost in c.lost})
        rows.append([case, o.case.pairing, true, _said(o), given, "; ".join(methods)])
    return rows


def _target(row: ScoreRow) -> str:
    if row.target is None:
        return ""
    value = f"{100 * row.target:g} %" if row.percent else f"{row.target:g}"
    if row.ceiling is not None:
        return f"{value} to {100 * row.ceiling:g} %"
    return f"{'at most' if row.most else 'at least'} {value}"


def _single(o: ScoredCase) -> list[str]:
    """A case with one effect: the first name, its errors, and how hard the case is."""
    answer, first = o.answer, o.answer.first
    shares = (first.confidence if first else None, o.off(), o.off(True), o.closed())
    return [
        o.case.id,
        o.case.truth[0],
        first.name if first else answer.verdict or answer.status,
        *("" if share is None else f"{100 * share:.1f} %" for share in shares),
        *("" if nats is None else f"{nats:.0f}" for nats in (o.nats, o.margin)),
    ]


def _failing(o: ScoredCase) -> list[str]:
    """A failing case: what was said, what was true, and why it fails."""
    case = o.case
    true = "; ".join(f"{effect} {_numbers(v)}" for effect, v in case.concealed.items())
    return [
        case.id,
        case.pairing,
        case.nuisance,
        f"{case.drives} x {case.seconds:g} s {case.driving}",
        true or "nothing",
        _said(o),
        "" if o.margin is None else f"{o.margin:.0f} nats",
        reason(o),
    ]


def _said(o: ScoredCase) -> str:
    """The verdict, and what is named with its numbers and probability."""
    verdict = o.answer.verdict.replace("_", " ") or o.answer.status
    said = "; ".join(
        f"{s.name} {_numbers(s.values, '.3g')} ({s.confidence:.2f})" for s in o.answer.said
    )
    return f"{verdict}: {said}" if said else verdict


def _numbers(values: Mapping[str, float], digits: str = "g") -> str:
    return ", ".join(f"{name} {value:{digits}}" for name, value in values.items())


def reason(o: ScoredCase) -> str:
    """Why an answer did not pass."""
    if o.answer.status != "answered":
        return "no answer"
    if o.case.family == "nothing":
        return (
            "a name for nothing" if o.answer.said else "nothing is there, and it is not known what"
        )
    if o.case.family == "unknown":
        return _outside(o)
    return "; ".join([*_undecidable(o), *_missed(o)])


def _outside(o: ScoredCase) -> str:
    """Why an answer to a case outside the library did not pass."""
    if o.answer.verdict == "no_mismatch":
        return "not seen"
    return "taken for what the library has" if o.sure_and_wrong else "named, though not surely"


def _undecidable(o: ScoredCase) -> list[str]:
    if o.failed:
        return ["not weighed"]
    if o.decidable is not False:
        return []
    if o.case.family != "one":
        return ["one of them hardly shows in these drives"]
    return ["another cause does as well on these drives"]


def _missed(o: ScoredCase) -> list[str]:
    """Why an answer about effects of the library did not pass."""
    answer, truth = o.answer, {*o.case.truth}
    if not answer.said:
        return ["not seen" if answer.verdict == "no_mismatch" else "no name earned its place"]
    rivals = {meant(name) for said in answer.said for name in said.rivals}
    missed = truth - answer.names
    found = [f"{name} stands as a rival" for name in sorted(missed & rivals)]
    found += [f"{name} is not named" for name in sorted(missed - rivals)]
    found += [f"{name} is not there" for name in sorted(answer.names - truth)]
    if answer.verdict == "unknown_physics":
        found.append("called unknown")
    # Only a single effect's order matters; of several the set does.
    if not found:
        found.append("the right name does not come first")
    return found
