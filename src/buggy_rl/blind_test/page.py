"""The page that shows a score, as Markdown, and why a case is among the failing ones."""

import os
from collections.abc import Mapping
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from buggy_rl.blind_test.case import DRIVING, NUISANCES
from buggy_rl.blind_test.equivalents import meant
from buggy_rl.blind_test.outcome import OURS, Outcome
from buggy_rl.blind_test.pictures import pictures
from buggy_rl.blind_test.proof import ProofConfig
from buggy_rl.blind_test.score import Row, Score, written
from buggy_rl.files import write_atomically

CAPTIONS = {
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
        scores: By method; those of the diagnosis under `OURS`.
        command: That makes the page again.
        opened: How often the sealed cases were scored.
        images: Kind of picture -> its path from the page.
    """
    own = scores[OURS]
    templates = Environment(
        loader=PackageLoader("buggy_rl.blind_test", ""),
        trim_blocks=True,
        keep_trailing_newline=True,
        undefined=StrictUndefined,
    )
    templates.filters["written"] = written
    return templates.get_template("page.md.jinja").render(
        command=command,
        split=config.draw.split,
        opened=opened,
        images=images,
        captions=CAPTIONS,
        score=own,
        others=[name for name in scores if name != OURS],
        figures=_figures(scores),
        nuisances=NUISANCES,
        driving=DRIVING,
        single=[_single(o) for o in sorted(own.single, key=lambda o: (o.case.truth, o.case.seed))],
        failing=[_failing(o) for o in own.failing],
    )


def write_page(config: ProofConfig, scores: Mapping[str, Score], command: str, opened: int) -> Path:
    """Writes the page and its pictures to the files of the config; the page's path."""
    file = Path(config.page or config.store.output / "proof.md")
    folder = Path(config.images or file.parent)
    folder.mkdir(parents=True, exist_ok=True)
    images = {}
    for kind, picture in pictures(scores[OURS]).items():
        image = folder / f"{file.stem}_{kind}.png"
        picture.savefig(image, dpi=130)
        images[kind] = os.path.relpath(image, file.parent)
    write_atomically(file, page(config, scores, command, opened, images))
    return file


def _figures(scores: Mapping[str, Score]) -> list[list[str]]:
    """A row for each figure: its target, the measured value, the cases, and other methods'."""
    others = [
        {row.name: written(row.figure, row.percent) for row in score.rows}
        for name, score in scores.items()
        if name != OURS
    ]
    rows = []
    for row in scores[OURS].rows:
        measured = written(row.figure, row.percent)
        rows.append(
            [
                # An indent shows that a figure is a part of the one above.
                row.name.replace("  ", "– ", 1) if row.name.startswith("  ") else row.name,
                _target(row),
                f"**{measured}**" if row.met is False else measured,
                row.figure.count,
                *(other.get(row.name, "") for other in others),
            ]
        )
    return rows


def _target(row: Row) -> str:
    if row.target is None:
        return ""
    value = f"{100 * row.target:g} %" if row.percent else f"{row.target:g}"
    if row.ceiling is not None:
        return f"{value} to {100 * row.ceiling:g} %"
    return f"{'at most' if row.most else 'at least'} {value}"


def _single(o: Outcome) -> list[str]:
    """A case with one effect: the first name, its errors, and how hard the case is."""
    first = o.first
    shares = (first and first.confidence, o.off(), o.off(True), o.closed())
    return [
        o.case.id,
        o.case.truth[0],
        first.name if first else o.verdict or o.status,
        *("" if share is None else f"{100 * share:.1f} %" for share in shares),
        *("" if nats is None else f"{nats:.0f}" for nats in (o.nats, o.margin)),
    ]


def _failing(o: Outcome) -> list[str]:
    """A failing case: what was said, what was true, and why it fails."""
    case = o.case
    true = "; ".join(f"{effect} {_numbers(v)}" for effect, v in case.concealed.items())
    said = "; ".join(f"{s.name} {_numbers(s.values, '.3g')} ({s.confidence:.2f})" for s in o.said)
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


def _numbers(values: Mapping[str, float], digits: str = "g") -> str:
    return ", ".join(f"{name} {value:{digits}}" for name, value in values.items())


def reason(o: Outcome) -> str:
    """Why an answer did not pass."""
    if o.status != "answered":
        return "no answer"
    if o.case.family == "nothing":
        return "a name for nothing" if o.said else "nothing is there, and it is not known what"
    if o.case.family == "unknown":
        return _outside(o)
    return "; ".join([*_undecidable(o), *_missed(o)])


def _outside(o: Outcome) -> str:
    """Of a case outside the library."""
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
    """Of effects of the library."""
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
