"""The report as one file that needs no other."""

from collections.abc import Sequence
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from buggy_rl.diagnosis.answer import Answer, described
from buggy_rl.diagnosis.case import Case
from buggy_rl.diagnosis.constancy import WORDS
from buggy_rl.diagnosis.named_effect import NORMAL
from buggy_rl.diagnosis.report import wording
from buggy_rl.diagnosis.report.figures import errors, is_repaired, replays
from buggy_rl.diagnosis.report.ranking import alternatives, ranking
from buggy_rl.diagnosis.search_result import SearchResult
from buggy_rl.estimation.segments import WARM_UP
from buggy_rl.viz.errors import map_figure, situation_figure
from buggy_rl.viz.replays import replay_figure
from buggy_rl.viz.svg import svg

RANKED = 10  # single effects in the chart of evidence
REJECTED = 5  # alternatives listed for each effect
PROOF = {  # column of the proof -> its heading
    "before": "as given",
    "retuned": "re-tuned only",
    "after": "repaired",
    "black_box": "black box",
    "noise_floor": "sensor noise",
}
Drawing = tuple[str, str]  # caption and SVG element


def report(case: Case, found: SearchResult, answer: Answer) -> str:
    """The report: readable on a phone, printed, and without a network.

    Args:
        case: What was compared.
        found: Result of the search.
        answer: Of the diagnosis.

    Returns:
        HTML.
    """
    return rendered(case, found, answer, drawn(case, found), error_maps(case))


def drawn(case: Case, found: SearchResult) -> list[Drawing]:
    """Replayed segments."""
    result = []
    for replay in replays(case, found):
        end = replay.begin + float(replay.time[-1])
        caption = f"{replay.recording}, {replay.begin:.1f} to {end:.1f} s: {replay.why}"
        result.append((caption, svg(replay_figure, replay, caption)))
    return result


def error_maps(case: Case) -> list[Drawing]:
    """Errors over the floor, and over steering and speed."""
    seen = errors(case)
    over = "Error of the simulator as given by position; noise alone is 1."
    within = (
        "Error of the simulator as given by speed and steering. Hatched: hardly or never driven."
    )
    return [
        (over, svg(map_figure, seen, over)),
        (within, svg(situation_figure, seen, within)),
    ]


def rendered(
    case: Case,
    found: SearchResult,
    answer: Answer,
    segments: Sequence[Drawing],
    maps: Sequence[Drawing],
) -> str:
    """The template, filled in."""
    templates = Environment(
        loader=PackageLoader("buggy_rl.diagnosis.report", ""),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=StrictUndefined,
    )
    templates.filters |= wording.FILTERS
    library = case.as_given
    return templates.get_template("report.html.jinja").render(
        case=case,
        found=found,
        answer=answer,
        segments=segments,
        maps=maps,
        meaning=wording.MEANINGS[answer.verdict],
        repaired=is_repaired(case, found),
        lags=wording.lags(answer.located.lags),
        ranks=ranking(found, RANKED),
        given={e.name: {p.name: p for p in library.numbers(e.name)} for e in answer.effects},
        conditions=WORDS,
        alternatives=_alternatives(found, answer),
        described=described(answer.remaining),
        proof=_proof(answer),
        made=_made(case, found, answer),
    )


def _alternatives(found: SearchResult, answer: Answer) -> list[tuple[str, list[str], list[str]]]:
    """Of each effect that was searched for: alternatives not distinguishable, and rejected."""
    result = []
    for e in answer.effects:
        if e.name not in found.best.effects:
            continue
        open_ = [
            f"{wording.effect(name)}: probability {wording.percent(p)}"
            for name, p in e.confused_with.items()
        ]
        rejected = [
            f"{wording.effect(name)}: worse by {nats:.0f} nats"
            for name, nats in alternatives(found, e.name)
            if name not in e.confused_with
        ]
        result.append((e.name, open_, rejected[:REJECTED]))
    return result


def _proof(answer: Answer) -> dict[str, Any]:
    """Table of rollout errors: its head, and a row for each horizon."""
    proof = answer.proof
    columns = {name: getattr(proof, name) for name in PROOF if getattr(proof, name)}
    return {
        "head": [PROOF[name] for name in columns],
        "rows": {
            f"{h:g} s": [
                wording.distance(values.get(h), proof.median.get(name, {}).get(h))
                for name, values in columns.items()
            ]
            for h in sorted(proof.before)
        },
    }


def _made(case: Case, found: SearchResult, answer: Answer) -> list[str]:
    """What was compared, and how."""
    segments, fit = case.problem.segments, found.best.fit
    seconds = sum(r.duration for r in case.recordings)
    scale = 1000 * fit.coordinates[-1].parameter.size  # [ms] the clock's prior scale
    sd = float(found.best.cross_validated.covariance[-1, -1].clamp_min(0.0).sqrt())
    offset, spread = scale * float(fit.vector[-1]), scale * NORMAL * sd
    return [
        f"{len(case.names)} recordings, {seconds:.0f} s: {', '.join(case.names)}.",
        f"{len(segments)} rollout segments of {segments.horizon * segments.dt:g} s; in the "
        f"{WARM_UP:g} s before each the measured motion is imposed, so that latent "
        "states settle.",
        f"{len(case.problem.library.names)} effects and parameters in the library, "
        f"{len(found.tried)} hypotheses fitted.",
        f"Clock offset: commands act {offset:+z.0f} ms later than stamped (95% interval "
        f"{offset - spread:+z.0f} to {offset + spread:+z.0f} ms); fitted in every hypothesis.",
        *answer.notes,
    ]
