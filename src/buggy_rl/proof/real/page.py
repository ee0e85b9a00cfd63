"""The page of the proof on real recordings, as Markdown."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from buggy_rl.core.files import write_atomically
from buggy_rl.proof.markdown import page_of, table
from buggy_rl.proof.page import MEASURED, figure_cells, strength_cells
from buggy_rl.proof.real.known import KnownResult
from buggy_rl.proof.real.real import RealProofConfig
from buggy_rl.proof.real.score import RealOutcome, RealScore, VisibleEffect
from buggy_rl.proof.score.figures import written
from buggy_rl.proof.score.outcome import CaseAnswer
from buggy_rl.proof.score.strength import VISIBLE

VERDICTS = {True: "right", False: "**not right**", None: "not diagnosed"}


def real_page(
    config: RealProofConfig,
    score: RealScore,
    known: Sequence[KnownResult],
    command: str,
    opened: int,
    made: Sequence[str] = (),
) -> str:
    """The whole page.

    Args:
        config: Of the run.
        score: Of all cases that were opened.
        known: Known changes that were measured.
        command: That makes the page again.
        opened: How often the cases were counted.
        made: When and by which code they were answered, in words.
    """
    return page_of(
        "buggy_rl.proof.real",
        "real.md.jinja",
        command=command,
        opened=opened,
        made="; ".join(made),
        hashes=config.store.hashes.name,
        least=config.draw.least,
        visible=VISIBLE,
        tables=real_tables(score),
        strengths=[strength_cells(row) for row in score.strengths],
        classes={
            name: [[label, *map(written, both), both[0].count] for label, both in rows.items()]
            for name, rows in score.classes.items()
        },
        visible_effects=[_visible(effect) for effect in score.visible],
        wrong=[_wrong(outcome) for outcome in score.wrong],
        measured=[row for result in known for row in _measured(result)],
        known=[_known(result) for result in known],
    )


def write_real_page(
    config: RealProofConfig,
    score: RealScore,
    known: Sequence[KnownResult],
    command: str,
    opened: int,
    made: Sequence[str] = (),
) -> Path:
    """Writes the page to the file of the config; its path."""
    file = Path(config.page or config.store.output / "proof_real.md")
    write_atomically(file, real_page(config, score, known, command, opened, made))
    return file


def real_tables(score: RealScore, made: Sequence[str] = ()) -> dict[str, str]:
    """Tables that other pages may have too, by name.

    Args:
        score: Of all cases that were opened.
        made: When and by which code they were answered, in words.
    """
    return {
        "counted": "; ".join((f"{score.cases} cases", *made)) + ".",
        "answers": table(MEASURED, map(figure_cells, score.rows)),
        "targets": table(MEASURED, (figure_cells(r) for r in score.rows if r.target is not None)),
        "named": _named(score),
    }


def _named(score: RealScore) -> str:
    """How many effects are named of those that are strong enough, and of how many names."""
    visible = score.visible
    named = sum(effect.named for effect in visible)
    behind = sum(effect.first and not effect.named for effect in visible)
    wrong = sum(len(o.wrong) for o in score.wrong)
    misnamed = sum(o.scored.case.family == "unknown" for o in score.wrong)
    return (
        f"Effects concealed: {score.effects}; above {VISIBLE:g} nats: {len(visible)}, of which "
        f"{named} named above one half, {behind} first with less, {len(visible) - named - behind} "
        f"neither. Names above one half: {score.names}, of which {wrong} wrong. Edits that no "
        f"effect describes: {score.unknown}, of which {misnamed} with a name above one half."
    )


def _wrong(outcome: RealOutcome) -> list[str]:
    case, weakest = outcome.case, outcome.weakest
    true = "; ".join(f"{name} {_numbers(values)}" for name, values in case.concealed.items())
    return [
        case.id,
        f"{case.dataset} {case.half}",
        case.engine,
        "given" if case.baseline else "",
        true or "nothing",
        "" if weakest is None else f"{weakest:.0f}",
        _said(outcome.scored.answer),
    ]


def _visible(effect: VisibleEffect) -> list[str]:
    case = effect.outcome.case
    return [
        case.id,
        f"{case.dataset} {case.half}",
        case.engine,
        "given" if case.baseline else "",
        f"{effect.effect} {_numbers(case.concealed[effect.effect])}",
        f"{effect.nats:.0f}",
        "named" if effect.named else "first" if effect.first else "",
        _said(effect.outcome.scored.answer),
    ]


def _said(answer: CaseAnswer) -> str:
    said = "; ".join(
        " ".join(filter(None, (s.name, _numbers(s.values, ".3g"), f"({s.confidence:.2f})")))
        for s in answer.said
    )
    verdict = answer.verdict.replace("_", " ") or answer.status
    return f"{verdict}: {said}" if said else verdict


def _numbers(values: Mapping[str, float], digits: str = "g") -> str:
    return ", ".join(f"{name} {value:{digits}}" for name, value in values.items())


def _measured(result: KnownResult) -> list[list[str]]:
    changed = result.change.change or "nothing"
    return [
        [
            *(result.name.replace("_", " "), changed, m.name),
            *(f"{m.before:.3g} {m.unit}", f"{m.after:.3g} {m.unit}"),
            f"{m.ratio:.2f} ({m.low:.2f} to {m.high:.2f})",
        ]
        for m in result.measured
    ]


def _known(result: KnownResult) -> list[str]:
    change = result.change
    return [
        result.name.replace("_", " "),
        change.change or "nothing",
        ", ".join(f"`{name}`" for name in change.effects) or "nothing above one half",
        _said(result.answer) if result.answer else "",
        VERDICTS[result.right],
    ]
