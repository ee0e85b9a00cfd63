"""The page that shows a score, as Markdown."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from buggy_rl.blind_test.case import DRIVING, NUISANCES
from buggy_rl.blind_test.outcome import OURS, Outcome
from buggy_rl.blind_test.proof import ProofConfig
from buggy_rl.blind_test.reasons import reason
from buggy_rl.blind_test.score import Row, Score, written
from buggy_rl.blind_test.statistics import Figure

WORDS = {
    "figures": "Every share with its interval",
    "classes": "First names by effect, pairing, nuisance, size, length and driving",
    "confidence": "Calibration, and accuracy against coverage",
    "confusion": "What was concealed against what was said first",
}


def page(
    config: ProofConfig,
    scores: Mapping[str, Score],
    command: str,
    opened: int,
    images: Mapping[str, str],
) -> str:
    """The whole page.

    Args:
        config: Of the run.
        scores: By who answered; the tool's own under `OURS`.
        command: That makes the page again.
        opened: How often the sealed answers were opened.
        images: Kind of picture -> its path from the page.
    """
    own = scores[OURS]
    parts = [
        "# Proof: physics concealed, found, counted",
        _about(config, command, opened),
        "## The figures",
        figures(scores),
        *(f"![{WORDS[kind]}]({path})" for kind, path in images.items()),
        "## False positives, by nuisance",
        table(("nuisance", "something named where nothing is"), own.false_positives, NUISANCES),
        "## Single effects: first name right",
        *(
            f"By {name}:\n\n{table((name, 'first name right'), rows, DRIVING)}"
            for name, rows in own.breakdown.items()
        ),
        "Case by case: error of the numbers against the truth and against the true structure "
        "fitted to the same drives, gap closed of what that closes, and nats by which it beats the "
        "simulator as given and the closest other effect.",
        singles(own.single),
        "## Cases that fail",
        failing(own.failing),
    ]
    return "\n\n".join(parts) + "\n"


def write_page(config: ProofConfig, scores: Mapping[str, Score], command: str, opened: int) -> Path:
    """Writes the page and its pictures where the config says; the page's place."""
    from buggy_rl.blind_test.pictures import pictures

    file = Path(config.page or config.vault.output / "proof.md")
    folder = Path(config.images or file.parent)
    folder.mkdir(parents=True, exist_ok=True)
    images = {}
    for kind, picture in pictures(scores[OURS]).items():
        place = folder / f"{file.stem}_{kind}.png"
        picture.savefig(place, dpi=130)
        images[kind] = os.path.relpath(place, file.parent)
    file.write_text(page(config, scores, command, opened, images))
    return file


def _about(config: ProofConfig, command: str, opened: int) -> str:
    split = config.draw.split
    times = (
        f"The sealed answers were opened {opened} time{'s' if opened != 1 else ''}."
        if split == "sealed"
        else "These are development seeds: what is shown here was tuned on them."
    )
    return (
        f"Made by\n\n```sh\n{command}\n```\n\n"
        "A generator draws cars, drives them, and seals what is wrong with them; hashes of the "
        "answers are published before the diagnosis, a process of its own, sees the drives. "
        f"Nothing on this page is written by hand. {times} Intervals are 95 %: Wilson's of "
        "shares, a bootstrap's of medians. A case is decidable when the true effect, fitted to the "
        "same drives, beats every other single effect by 10 nats. What misses its target is bold."
    )


def figures(scores: Mapping[str, Score]) -> str:
    """One row a figure: target, measured with interval, number of cases, and others beside it."""
    others = {name: _named(score.rows) for name, score in scores.items() if name != OURS}
    head = ["figure", "target", "measured", "n", *others]
    rows = []
    for row in scores[OURS].rows:
        beside = [
            written(other[row.name].figure, row.percent) if row.name in other else ""
            for other in others.values()
        ]
        measured = written(row.figure, row.percent)
        if row.met is False:
            measured = f"**{measured}**"
        # Inner blanks are kept: they show what is a part of what.
        name = row.name.replace("  ", "– ", 1) if row.name.startswith("  ") else row.name
        rows.append([name, _target(row), measured, str(row.figure.count), *beside])
    return _markdown(head, rows)


def table(
    head: Sequence[str], rows: Mapping[str, Figure], words: Mapping[str, str] | None = None
) -> str:
    """Classes and their figure."""
    words = words or {}
    named = {name: f"{name}: {words[name]}" if name in words else name for name in rows}
    lines = [[named[name], written(figure), str(figure.count)] for name, figure in rows.items()]
    return _markdown([*head, "n"], lines)


def singles(outcomes: Sequence[Outcome]) -> str:
    """Every case with one effect: what was said first, how well, and how hard it was."""
    head = ["case", "true", "said first", "sure", "error", "by the oracle", "gap closed"]
    head += ["nats", "margin"]
    rows = []
    for o in sorted(outcomes, key=lambda o: (o.case.truth, o.case.seed)):
        first = o.first
        shares = (first and first.confidence, o.off(), o.off(True), o.closed())
        rows.append(
            [
                o.case.id,
                o.case.truth[0],
                first.name if first else o.verdict or o.status,
                *("" if share is None else f"{100 * share:.1f} %" for share in shares),
                *("" if nats is None else f"{nats:.0f}" for nats in (o.nats, o.margin)),
            ]
        )
    return _markdown(head, rows)


def failing(outcomes: Sequence[Outcome]) -> str:
    """Cases that were not answered as one could ask: what was said, what was true, and why."""
    if not outcomes:
        return "None."
    head = ["case", "pairing", "nuisance", "drives", "true", "said", "margin", "why"]
    return _markdown(head, [_failed(o) for o in outcomes])


def _failed(o: Outcome) -> list[str]:
    case = o.case
    true = "; ".join(
        f"{effect} {', '.join(f'{k} {v:g}' for k, v in values.items())}"
        for effect, values in case.concealed.items()
    )
    said = "; ".join(
        f"{s.name} {', '.join(f'{k} {v:.3g}' for k, v in s.values.items())} ({s.confidence:.2f})"
        for s in o.said
    )
    verdict = o.verdict.replace("_", " ") or o.status
    return [
        case.id,
        case.pairing,
        case.nuisance,
        f"{case.drives} x {case.seconds:g} s {case.driving}",
        true or "nothing",
        f"{verdict}: {said}" if said else verdict,
        "" if o.margin is None else f"{o.margin:.0f} nats",
        reason(o),
    ]


def _target(row: Row) -> str:
    if row.target is None:
        return ""
    value = f"{100 * row.target:g} %" if row.percent else f"{row.target:g}"
    if row.ceiling is not None:
        return f"{value} to {100 * row.ceiling:g} %"
    return f"{'at most' if row.most else 'at least'} {value}"


def _named(rows: Sequence[Row]) -> dict[str, Row]:
    return {row.name: row for row in rows}


def _markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
