"""What the page says, part by part."""

import math

from buggy_rl.diagnosis.answer import NORMAL, Answer, described
from buggy_rl.diagnosis.case import Case
from buggy_rl.diagnosis.report import wording
from buggy_rl.diagnosis.report.error_figures import map_figure, situation_figure
from buggy_rl.diagnosis.report.errors import errors
from buggy_rl.diagnosis.report.markup import (
    Bar,
    Markup,
    bars,
    figure,
    listed,
    section,
    table,
    tag,
    titled,
)
from buggy_rl.diagnosis.report.replay_figure import replay_figure
from buggy_rl.diagnosis.report.replays import replays
from buggy_rl.diagnosis.report.style import inline
from buggy_rl.diagnosis.search import Found, Search
from buggy_rl.estimation.segments import WARM_UP

WORST = 5  # intervals that are listed
PROVEN = {  # column of the proof -> its heading
    "before": "as given",
    "retuned": "re-tuned only",
    "after": "repaired",
    "black_box": "black box",
    "noise_floor": "sensor noise",
}


def verdict(answer: Answer) -> Markup:
    """The sentence, and how sure it is."""
    first, *others = answer.lines()
    sure = [
        Bar(wording.cause(e.name), e.confidence, wording.sure(e.confidence), True)
        for e in answer.effects
    ]
    return tag(
        "header",
        tag("span", wording.VERDICTS[answer.verdict], of=f"chip {answer.verdict}"),
        tag("h1", first),
        *(tag("p", line, of="lead") for line in others),
        bars(sure),
        tag("p", wording.MEANINGS[answer.verdict], of="quiet"),
    )


def driven(case: Case, found: Found) -> Markup:
    """Measured against simulated against repaired."""
    drawn = []
    for replay in replays(case, found):
        end = replay.begin + float(replay.time[-1])
        caption = f"{replay.recording}, {replay.begin:.1f} to {end:.1f} s: {replay.why}"
        drawn.append(figure(inline(replay_figure(replay), caption), caption))
    repaired = (
        " Dashed: the simulator with what was found in it."
        if found.best.causes or case.retuned_from is not None
        else " Nothing was named, so there is no repaired simulator to show."
    )
    return section(
        "What the car did, and what the simulator says",
        tag(
            "p",
            "Grey: measured. Red: the same commands played into the simulator as it was given, "
            f"started where the car was.{repaired} Paths begin at the open dot, heading right.",
        ),
        tag("div", *drawn, of="figures"),
    )


def located(case: Case, answer: Answer) -> Markup:
    """Where the error lives."""
    where = answer.located
    seen = errors(case)
    shares = [
        Bar(wording.CHANNELS[channel], share, wording.percent(share))
        for channel, share in where.channel_share.items()
    ]
    over = "Where in the room the simulator as given errs. Dark is bad; noise alone is 1."
    within = "At which speed and steering. Hatched: never, or hardly, driven."
    times = [
        f"{i.recording}, {i.begin:.1f} to {i.end:.1f} s: {wording.percent(i.error_share)} of the "
        "error"
        for i in where.intervals[:WORST]
    ]
    return section(
        "Where the error lives",
        tag("h3", "In which motion"),
        bars(shares),
        tag(
            "div",
            figure(inline(map_figure(seen), over), over),
            figure(inline(situation_figure(seen), within), within),
            of="figures",
        ),
        titled("Where errors crowd", [wording.region(r) for r in where.regions]),
        titled("When", times),
        titled("After which command", wording.lags(where.lags)),
    )


def remains(answer: Answer) -> Markup:
    """What is left over."""
    rest = answer.remaining
    rows = [
        Bar(wording.CHANNELS.get(channel, channel), share, wording.percent(share))
        for channel, share in rest.channel.items()
    ]
    return section(
        "What remains",
        tag("p", described(rest), of="lead"),
        tag(
            "p",
            f"{wording.percent(rest.share)} of the gap there was beyond the sensor's noise is not "
            "explained.",
        ),
        bars(rows) if sum(rest.channel.values()) > 0 else "",
    )


def proven(answer: Answer) -> Markup:
    """Before and after, on what was held out."""
    proof = answer.proof
    columns = {n: getattr(proof, n) for n in PROVEN if getattr(proof, n)}
    rows = [
        [
            f"{h:g} s",
            *(_distance(v.get(h), proof.median.get(n, {}).get(h)) for n, v in columns.items()),
        ]
        for h in sorted(proof.before)
    ]
    how = (
        "Fitted to one part of the drives and judged on the other."
        if proof.held_out
        else "Judged on the drives it was fitted to: nothing could be held out."
    )
    return section(
        "Before and after",
        tag("p", f"How far a simulated car is from the measured one. {how}"),
        table(("after", *(PROVEN[n] for n in columns)), rows),
        tag(
            "p",
            "Root mean square distance over the time up to then, in brackets the median of all "
            "rollouts, which a single spin does not outweigh. All six readings of 1 s together, "
            f"in units of the sensor's noise: {wording.number(proof.misfit_before)} before, "
            f"{wording.number(proof.misfit_after)} after; 1 is perfect.",
            of="quiet",
        ),
    )


def _distance(square: float | None, median: float | None) -> str:
    """Of a mean square [m^2] and a median [m]; a dash where there is none."""
    if square is None or not math.isfinite(square):
        return "–"
    bracket = "" if median is None else f" ({1000 * median:.0f})"
    return f"{1000 * math.sqrt(square):.0f} mm{bracket}"


def following(answer: Answer) -> Markup:
    """What to drive next."""
    decided = answer.verdict not in ("unknown_physics", "cannot_tell")
    nothing = (
        "These drives decide all that was asked; nothing has to be driven again."
        if decided
        else "No manoeuvre of the library is known to decide what these drives leave open."
    )
    return section(
        "What to drive next",
        titled("Would decide", answer.suggest),
        titled("Was hardly driven, and what that hides", answer.weak),
        "" if answer.suggest or answer.weak else tag("p", nothing),
    )


def made(case: Case, search: Search, found: Found, answer: Answer) -> Markup:
    """How all this was come by."""
    cut = case.cut
    seconds = sum(r.duration for r in case.recordings)
    later, spread = _clock(found)
    return section(
        "How it was found",
        listed(
            [
                f"{len(case.names)} drives, {seconds:.0f} s: {', '.join(case.names)}.",
                f"{len(cut)} stretches of {cut.horizon * cut.dt:g} s, each begun with "
                f"{WARM_UP * cut.dt:g} s of measured motion so that hidden states settle.",
                f"{len(case.library.causes)} causes to choose from, "
                f"{len(found.tried)} explanations fitted, all stretches simulated "
                f"{search.fitter.plays} times.",
                f"Commands act {later:+z.0f} ms later than stamped (95%: {later - spread:+z.0f} to "
                f"{later + spread:+z.0f} ms); every explanation was allowed such an offset.",
                *answer.notes,
            ]
        ),
    )


def _clock(found: Found) -> tuple[float, float]:
    """Offset of the commands' clock and half its interval [ms]."""
    fitted = found.best.fitted
    size = fitted.unknowns[-1].parameter.size
    sd = float(found.best.evidence.covariance[-1, -1].clamp_min(0.0).sqrt())
    return 1000 * size * float(fitted.place[-1]), 1000 * size * NORMAL * sd
