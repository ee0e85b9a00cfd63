"""The report as one file that needs no other."""

import math
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal

import yaml
from jinja2 import Environment, PackageLoader, StrictUndefined

from buggy_rl.diagnosis.answer.answer import OPEN, Answer, describe_unexplained
from buggy_rl.diagnosis.answer.behaviour import differing
from buggy_rl.diagnosis.answer.equivalents import Equivalents
from buggy_rl.diagnosis.answer.located import locate
from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.diagnosis.repair.layers import Layer
from buggy_rl.diagnosis.repair.proof import Repair
from buggy_rl.diagnosis.report import wording
from buggy_rl.diagnosis.report.figures import (
    Film,
    errors,
    manoeuvre_plan,
    replays,
    worst_segment,
)
from buggy_rl.diagnosis.report.wording import alternatives, ranking
from buggy_rl.diagnosis.residuals import CONDITIONS
from buggy_rl.diagnosis.run.case import DiagnosisCase
from buggy_rl.diagnosis.search.posterior import NORMAL
from buggy_rl.diagnosis.search.result import SearchResult
from buggy_rl.estimation.segments import WARM_UP
from buggy_rl.figures.drives import manoeuvre_figure, replay_figure
from buggy_rl.figures.models import map_figure, situation_figure
from buggy_rl.figures.style import svg
from buggy_rl.simulators import simulator_name

BUGGY = "the buggy (no car= was given)"


@dataclass(frozen=True)
class Sheet:
    """Facts of a diagnosis that are in neither the case nor the answer."""

    facts: Mapping[str, str] = field(default_factory=dict)
    """Label -> value, at the foot of the page."""
    repaired: str = ""
    """Content of repaired.yaml; empty where it is not known."""


def sheet_of(config: DiagnosisConfig, repaired: Mapping[str, Any]) -> Sheet:
    """The sheet of a diagnosis by this process, today.

    Args:
        config: The question.
        repaired: Content of repaired.yaml.
    """
    try:
        release = version("buggy_rl")
    except PackageNotFoundError:  # run from a source tree that is not installed
        release = "not installed"
    script = Path(sys.argv[0])
    words = [f"{script.parent.name}/{script.name}" if script.parent.name else script.name]
    verb = script.name.startswith("buggy-rl ")  # it is a program by itself
    words = script.name.split() if verb else ["python", *words]
    facts = {
        "Simulator": simulator_name(config.simulator),
        "Car": config.car or BUGGY,
        "Recordings": ", ".join(config.recordings),
        **({"Baseline": ", ".join(config.baseline)} if config.baseline else {}),
        "Date": date.today().isoformat(),
        "Version": f"buggy_rl {release}",
        "Command": shlex.join([*words, *sys.argv[1:]]),
    }
    return Sheet(facts, yaml.safe_dump(dict(repaired), sort_keys=False))


RANKED = 10  # single effects in the chart of evidence
REJECTED = 5  # alternatives listed for each effect
LEAST_NATS = 10.0  # of a full bar in the chart of evidence
SPOKEN = 5  # differences of behaviour at the head of a page that names nothing surely
NOISE = 0.1  # [-] excess misfit below which what is left is noise, as `describe_unexplained` says
LOCATED = 5  # intervals with large errors that are listed
MANY = 2  # parameters of the simulator's own, above which they share a table
NAMED = ("missing_physics", "wrong_parameters")  # verdicts whose first effect heads the page
PROOF = {  # column of the proof -> its heading
    "before": "as given",
    "retuned": "re-tuned only",
    "after": "repaired",
    "black_box": "black box",
    "noise_floor": "without fault",
}
COMPARED = {  # with the layers of a repair
    "retuned": "re-tuned alone",
    "black_box": "residual alone",
    "noise_floor": "a simulator without fault (noise of sensor and start)",
}
Drawing = tuple[str, str]  # caption and SVG element


@dataclass(frozen=True)
class Pictures:
    """Pictures of the page; what there is nothing to draw of is empty."""

    film: Film | None = None
    segments: Sequence[Drawing] = ()
    manoeuvre: Sequence[Drawing] = ()
    maps: Sequence[Drawing] = ()


NO_PICTURES, NO_SHEET = Pictures(), Sheet()


def report(
    case: DiagnosisCase, found: SearchResult, answer: Answer, sheet: Sheet = NO_SHEET
) -> str:
    """The report: readable on a phone, printed, and without a network.

    Args:
        case: What was compared.
        found: Result of the search.
        answer: Of the diagnosis.
        sheet: What was asked, by what and when, and the repaired simulator's file.

    Returns:
        HTML.
    """
    pictures = Pictures(
        film=worst_segment(case, answer.repair),
        segments=_drawn(case, found, answer.repair),
        manoeuvre=planned(case, found, answer),
        maps=error_maps(case, answer.repair) if something_is_left(answer) else (),
    )
    return rendered(case, found, answer, pictures, sheet)


def something_is_left(answer: Answer) -> bool:
    """Whether a part of the error is not explained, which can be located."""
    return answer.remaining.excess >= NOISE


def _drawn(case: DiagnosisCase, found: SearchResult, repair: Repair) -> list[Drawing]:
    """Draws the replayed segments."""
    result = []
    for replay in replays(case, found, repair):
        end = replay.begin + float(replay.time[-1])
        caption = f"{replay.recording}, {replay.begin:.1f} to {end:.1f} s: {replay.why}"
        result.append((caption, svg(replay_figure, replay, caption)))
    return result


def planned(case: DiagnosisCase, found: SearchResult, answer: Answer) -> list[Drawing]:
    """The manoeuvre to drive next."""
    plan = manoeuvre_plan(case, found, answer)
    if plan is None:
        return []
    caption = (
        f"{wording.capital(answer.manoeuvres[0].words)}, from rest: what to command, and what each "
        "of the hypotheses left predicts."
    )
    return [(caption, svg(manoeuvre_figure, plan, caption))]


def error_maps(case: DiagnosisCase, repair: Repair) -> list[Drawing]:
    """Errors that are left over the floor, and over steering and speed."""
    seen = errors(case, repair)
    who = "repaired simulator" if repair.is_one else "simulator as given"
    over = f"Error of the {who} by position; noise alone is 1."
    within = f"Error of the {who} by speed and steering. Hatched: hardly or never driven."
    return [
        (over, svg(map_figure, seen, over)),
        (within, svg(situation_figure, seen, within)),
    ]


def rendered(
    case: DiagnosisCase,
    found: SearchResult,
    answer: Answer,
    pictures: Pictures = NO_PICTURES,
    sheet: Sheet = NO_SHEET,
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
    library, ranks = case.as_given, ranking(found, RANKED)
    equivalents = {e.effects[0]: e for e in answer.equivalents}
    own = [e for e in answer.effects if e.kind == "parameter"]
    cards = [e for e in answer.said if e not in own or len(own) <= MANY]
    return templates.get_template("report.html.jinja").render(
        case=case,
        found=found,
        answer=answer,
        pictures=pictures,
        sheet=sheet,
        heading=_heading(answer, equivalents),
        cards=cards,
        own=own if len(own) > MANY else [],
        equivalents=equivalents,
        meaning=wording.MEANINGS[answer.verdict],
        repaired=answer.repair.is_one,
        waterfall=waterfall(answer),
        located=_located(case, answer),
        differing=differing(answer.behaviours)[:SPOKEN] if answer.verdict in OPEN else [],
        ranks=ranks,
        most=max([LEAST_NATS, *(rank.nats for rank in ranks)]),
        given={e.name: {p.name: p for p in library.numbers(e.name)} for e in answer.effects},
        conditions={name: c.varying or c.words for name, c in CONDITIONS.items()},
        alternatives=_alternatives(found, answer),
        described=describe_unexplained(answer.remaining),
        proof=_proof(answer),
        made=_made(case, found, answer),
    )


def _heading(answer: Answer, equivalents: Mapping[str, Equivalents]) -> tuple[str, str]:
    """The finding in words where one is named surely, and the verdict; else the verdict alone."""
    verdict, *more = answer.lines()
    if answer.verdict not in NAMED or not answer.effects:
        return verdict, more[0] if answer.by_recording else ""
    first = answer.effects[0]
    if first.name in equivalents:
        return equivalents[first.name].line(), verdict
    return f"{wording.capital(first.sentence)}.", verdict


def _located(case: DiagnosisCase, answer: Answer) -> dict[str, Any]:
    """Places of errors that the repair does not explain; nothing where noise is left."""
    if not something_is_left(answer):
        return {}
    where = answer.located
    if answer.repair.is_one:
        simulation, settings = answer.repair.simulation(case)
        segments, noise = case.problem.segments, case.problem.noise.sd
        where = locate(simulation, segments, noise, case.names, settings)
    return {
        "regions": [wording.region(region) for region in where.regions],
        "intervals": where.intervals[:LOCATED],
        "lags": wording.lags(where.lags),
    }


def _alternatives(found: SearchResult, answer: Answer) -> list[tuple[str, list[str], list[str]]]:
    """Alternatives to each effect that was searched for: not distinguishable, and rejected."""
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


@dataclass(frozen=True)
class Step:
    """A bar of the waterfall."""

    words: str
    median: Mapping[float, float]
    """Horizon [s] -> median distance [m] on what was held out."""
    kind: Literal["kept", "left", "compared"]
    """A layer of the repair, one that was tried and left out, or what it is compared with."""


def steps_of(layers: Sequence[Layer], median: Mapping[str, Mapping[float, float]]) -> list[Step]:
    """Steps from the simulator as given down to the noise.

    Args:
        layers: Of the repair, in their order.
        median: `before` and those of `COMPARED` -> horizon [s] -> median distance [m].
    """
    steps = [Step("as given", median.get("before", {}), "compared")]
    steps += [
        Step(wording.layer(layer), layer.median, "kept" if layer.kept else "left")
        for layer in layers
    ]
    return [
        *steps,
        *(Step(w, median[name], "compared") for name, w in COMPARED.items() if median.get(name)),
    ]


def waterfall(answer: Answer) -> dict[str, list[tuple[Step, float, str]]]:
    """Horizon in words -> steps from the simulator as given down to the noise, each with its bar.

    Returns:
        For each step its share of the longest bar of the horizon, and its distance in words.
    """
    if not answer.layers:
        return {}
    median = answer.proof.median
    steps = steps_of(answer.layers, median)
    result: dict[str, list[tuple[Step, float, str]]] = {}
    for horizon in median.get("before", {}):
        own = [s for s in steps if math.isfinite(s.median.get(horizon, math.nan))]
        longest = max(s.median[horizon] for s in own)
        result[f"{horizon:g} s"] = [
            (
                s,
                s.median[horizon] / longest if longest else 0.0,
                wording.millimetres(s.median[horizon]),
            )
            for s in own
        ]
    return result


def _made(case: DiagnosisCase, found: SearchResult, answer: Answer) -> list[str]:
    """Says what was compared, and how."""
    segments, fit = case.problem.segments, found.best.fit
    seconds = sum(r.duration for r in case.recordings)
    scale = 1000 * fit.coordinates[-1].parameter.size  # [ms] the clock's prior scale
    sd = float(found.best.cross_validated.covariance[-1, -1].clamp_min(0.0).sqrt())
    offset, spread = scale * float(fit.vector[-1]), scale * NORMAL * sd
    bounds = wording.between((offset - spread, offset + spread), "ms")
    return [
        f"{len(case.names)} recordings, {seconds:.0f} s: {', '.join(case.names)}.",
        f"{len(segments)} rollout segments of {segments.horizon * segments.dt:g} s; in the "
        f"{WARM_UP:g} s before each the measured motion is imposed, so that latent "
        "states settle.",
        f"{len(case.problem.library.names)} effects and parameters in the library, "
        f"{len(found.tried)} hypotheses fitted.",
        f"Clock offset: commands act {offset:+z.1f} ms later than stamped"
        f"{f' (95 % interval {bounds})' if bounds else ''}; fitted in every hypothesis.",
        *answer.notes,
    ]
