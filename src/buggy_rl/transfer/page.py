"""The page that shows what became of the policies, as Markdown."""

from collections.abc import Mapping, Sequence
from statistics import pstdev
from typing import Any

from buggy_rl.transfer.plan import ARMS, TransferConfig
from buggy_rl.transfer.score import (
    Pair,
    counted,
    kinds,
    mean,
    original_loss,
    over_seeds,
    targets,
    values,
)


def page(
    config: TransferConfig,
    drives: Sequence[Pair],
    said: Mapping[str, Mapping[str, Any]],
    command: str,
    picture: str,
) -> str:
    """The whole page.

    Args:
        config: Of the study.
        drives: From `score.pairs`.
        said: What the diagnosis said of each car.
        command: That makes the page again.
        picture: Its path from the page.
    """
    goals = [f"- {'Met' if t.met else '**Not met**'}: {t.sentence}" for t in targets(drives)]
    parts = [
        "# Transfer: policies on cars that their simulator was not made for",
        _about(config, drives, command),
        "\n".join(goals),
        "Closed on the car (in its own simulator), waypoints a minute, mean over seeds and paths; "
        "of the mean over the cars in which something is concealed the 95 % interval over seeds:",
        closed_table(drives),
        "Lost from simulator to car by path, waypoints a minute, mean ± sd over cars and seeds "
        "(the original's table 7.7):",
        lost_table(drives),
        _original(),
        f"![Waypoints closed in simulation and on the car]({picture})",
        "Mean distance from the path on the car (in its own simulator) [m], and times a minute "
        "that it had to be put back:",
        lateral_table(drives),
    ]
    if said:
        parts += ["What was concealed, and what the diagnosis said:", said_table(config, said)]
    return "\n\n".join(part for part in parts if part) + "\n"


def closed_table(drives: Sequence[Pair]) -> str:
    """A row for each car, one for their mean, and one for what is lost in the mean."""
    arms, judged = kinds(drives, "arm"), counted(drives)

    def cell(of: Sequence[Pair], **where: object) -> str:
        return f"{mean(of, 'there', **where):.1f} ({mean(of, 'own', **where):.1f})"

    def interval(arm: str, column: str) -> str:
        return _range(*over_seeds(judged, arm, column))

    rows = [[c, *(cell(drives, car=c, arm=arm) for arm in arms)] for c in kinds(drives, "car")]
    rows.append(["**mean**", *(f"**{cell(judged, arm=a)}**, {interval(a, 'there')}" for a in arms)])
    lost = [f"**{mean(judged, 'lost', arm=a):.1f}**, {interval(a, 'lost')}" for a in arms]
    return _markdown(["car", *arms], [*rows, ["**lost**", *lost]])


def lost_table(drives: Sequence[Pair]) -> str:
    """A row for each path, as in the original's table 7.7."""
    drives = counted(drives)
    arms, rows = kinds(drives, "arm"), []
    for course in kinds(drives, "course"):
        lost = [values(drives, "lost", course=course, arm=arm) for arm in arms]
        rows.append([course, *(f"{sum(v) / len(v):.1f} ± {pstdev(v):.1f}" for v in lost)])
    share = [mean(drives, "lost", arm=arm) / mean(drives, "own", arm=arm) for arm in arms]
    rows.append(["share of what it closed", *(f"{100 * s:.0f} %" for s in share)])
    return _markdown(["path", *arms], rows)


def lateral_table(drives: Sequence[Pair]) -> str:
    """A row for each car."""
    arms = kinds(drives, "arm")

    def cell(car: str, arm: str) -> str:
        there, own, lost, own_lost = (
            mean(drives, column, car=car, arm=arm)
            for column in ("lateral", "own_lateral", "put_back", "own_put_back")
        )
        return f"{there:.3f} ({own:.3f}), {lost:.1f} ({own_lost:.1f}) times"

    rows = [[car, *(cell(car, arm) for arm in arms)] for car in kinds(drives, "car")]
    return _markdown(["car", *arms], rows)


def said_table(config: TransferConfig, said: Mapping[str, Mapping[str, Any]]) -> str:
    """A row for each car that was diagnosed."""
    rows = []
    for car, answer in said.items():
        hidden = [_effect(effect, v) for effect, v in config.cars[car].items()]
        named = [
            _effect(e["name"], {k: v["value"] for k, v in e["parameters"].items()})
            + f" ({100 * e['confidence']:.0f} % sure)"
            for e in answer["effects"]
        ]
        verdict = answer["verdict"].replace("_", " ")
        rows.append([car, "; ".join(hidden) or "nothing", verdict, "; ".join(named) or "nothing"])
    return _markdown(["car", "concealed", "verdict", "named"], rows)


def _effect(name: str, numbers: Mapping[str, float]) -> str:
    return f"{name} {', '.join(f'{k} {v:.3g}' for k, v in numbers.items())}"


def _about(config: TransferConfig, drives: Sequence[Pair], command: str) -> str:
    arms = "\n".join(f"- **{arm}**: {ARMS[arm]}" for arm in kinds(drives, "arm"))
    return (
        f"Made by\n\n```sh\n{command}\n```\n\n"
        f"Policies of {config.steps / 1e6:g} million steps of PPO, "
        f"{len(kinds(drives, 'seed'))} seeds each, trained in\n\n{arms}\n\n{_cars(config)} "
        "The cars are reference cars in which something is wrong, seen through their camera; "
        f"{config.drives} drives of {config.seconds:g} s by a room driver are all that is known of "
        f"one. Lap and infinity are driven for {config.judged_seconds:g} s, the tight random path "
        "for 5 s. A car that leaves its path, or closes no waypoint in 2 s, is put back on it, "
        "at rest, and held for 2 s. Nothing on this page is written by hand."
    )


def _cars(config: TransferConfig) -> str:
    if not config.undecided:
        return "All cars of the first two are alike."
    return "In the first two each car has its own share of what the fit of MuJoCo left open."


def _original() -> str:
    parts = [
        f"{kind}: {lost:.1f} of {own:.1f} in an episode ({100 * lost / own:.0f} %)"
        for kind, (own, lost) in original_loss().items()
    ]
    return f"The original study's policies lost, on its real car, {', '.join(parts)}."


def _range(low: float, high: float) -> str:
    return "-" if low != low else f"{low:.1f} .. {high:.1f}"


def _markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
