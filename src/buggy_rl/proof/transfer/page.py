"""The page that shows the drives of all policies, as Markdown."""

from collections.abc import Mapping
from typing import Any

import matplotlib.pyplot as plt
import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from buggy_rl.figures.style import COLOURS, MEASURED_COLOUR, tidy
from buggy_rl.proof.transfer.plan import ARMS, TransferConfig
from buggy_rl.proof.transfer.score import counted, means, original_loss, over_seeds, targets


def transfer_page(
    config: TransferConfig,
    drives: pd.DataFrame,
    answers: Mapping[str, Mapping[str, Any]],
    command: str,
    picture: str,
) -> str:
    """The whole page.

    Args:
        config: Of the study.
        drives: From `score.pairs`.
        answers: `diagnosis.json` of each car.
        command: That makes the page again.
        picture: Its path from the page.
    """
    templates = Environment(
        loader=PackageLoader("buggy_rl.proof.transfer", ""),
        trim_blocks=True,
        keep_trailing_newline=True,
        undefined=StrictUndefined,
    )
    return templates.get_template("transfer.md.jinja").render(
        config=config,
        command=command,
        picture=picture,
        arms=list(drives.arm.unique()),
        seeds=drives.seed.nunique(),
        meaning=ARMS,
        targets=targets(drives),
        original=original_loss(),
        closed=_closed(drives),
        lost=_lost(counted(drives)),
        lateral=_lateral(drives),
        diagnosed=[_diagnosed(car, config.cars[car], answer) for car, answer in answers.items()],
    )


def _closed(drives: pd.DataFrame) -> list[list[str]]:
    """A row for each car, one for their mean, and one for the mean loss."""
    of_car, judged = means(drives, "car", "arm"), counted(drives)
    of_arm = means(judged, "arm")

    def interval(arm: str, column: str) -> str:
        low, high = over_seeds(judged, arm, column)
        return "-" if low != low else f"{low:.1f} .. {high:.1f}"

    def cell(row: pd.Series) -> str:
        return f"{row.there:.1f} ({row.own:.1f})"

    arms = drives.arm.unique()
    rows = [[c, *(cell(of_car.loc[(c, a)]) for a in arms)] for c in drives.car.unique()]
    mean = [f"**{cell(of_arm.loc[a])}**, {interval(a, 'there')}" for a in arms]
    lost = [f"**{of_arm.lost[a]:.1f}**, {interval(a, 'lost')}" for a in arms]
    return [*rows, ["**mean**", *mean], ["**lost**", *lost]]


def _lost(drives: pd.DataFrame) -> list[list[str]]:
    """A row for each path, and one for the share that is lost."""
    lost = drives.groupby(["course", "arm"], sort=False).lost
    mean, sd, arms = lost.mean(), lost.std(ddof=0), drives.arm.unique()
    rows = [
        [course, *(f"{mean[course, arm]:.1f} ± {sd[course, arm]:.1f}" for arm in arms)]
        for course in drives.course.unique()
    ]
    of_arm = means(drives, "arm")
    share = 100 * of_arm.lost / of_arm.own
    return [*rows, ["share of what it closed", *(f"{share[arm]:.0f} %" for arm in arms)]]


def _lateral(drives: pd.DataFrame) -> list[list[str]]:
    """A row for each car: distances from the path, and resets to it."""
    of_car = means(drives, "car", "arm")

    def cell(row: pd.Series) -> str:
        resets = f"{row.put_back:.1f} ({row.own_put_back:.1f}) times"
        return f"{row.lateral:.3f} ({row.own_lateral:.3f}), {resets}"

    arms = drives.arm.unique()
    return [[c, *(cell(of_car.loc[(c, a)]) for a in arms)] for c in drives.car.unique()]


def _diagnosed(
    car: str, concealed: Mapping[str, Mapping[str, float]], answer: Mapping[str, Any]
) -> list[str]:
    """A car: what is concealed in it, the verdict, and what was named."""
    named = [
        _effect(e["name"], {k: v["value"] for k, v in e["parameters"].items()})
        + f" ({100 * e['confidence']:.0f} % sure)"
        for e in answer["effects"]
    ]
    hidden = [_effect(effect, values) for effect, values in concealed.items()]
    verdict = answer["verdict"].replace("_", " ")
    return [car, "; ".join(hidden) or "nothing", verdict, "; ".join(named) or "nothing"]


def _effect(name: str, numbers: Mapping[str, float]) -> str:
    return f"{name} {', '.join(f'{k} {v:.3g}' for k, v in numbers.items())}"


SPREAD = 0.7  # of the room between two cars that their arms take up
BESIDE = 0.06  # [cars] how far the seeds stand beside their mean


def transfer_figure(drives: pd.DataFrame) -> Figure:
    """A place for each car, in it a line for each arm from its simulator (open) to the car (dot).

    Small dots are the seeds on the car. The drives are those of `score.pairs`.
    """
    arms, cars = list(drives.arm.unique()), list(drives.car.unique())
    figure, axis = plt.subplots(
        figsize=(max(1.3 * len(cars) + 1.5, 9.0), 4.2), layout="constrained"
    )
    for number, arm in enumerate(arms):
        for place, car in enumerate(cars):
            here = drives[(drives.car == car) & (drives.arm == arm)]
            own, there, colour = here.own.mean(), here.there.mean(), COLOURS[number]
            seeds = here.groupby("seed", sort=False).there.mean()
            x = place + SPREAD * ((number + 0.5) / len(arms) - 0.5)
            axis.plot([x, x], [own, there], color=colour, lw=2.5, alpha=0.35)
            axis.plot(x, own, "o", color=colour, mfc="white", ms=6)
            axis.plot(x, there, "o", color=colour, ms=6)
            axis.plot([x + BESIDE] * len(seeds), seeds, ".", color=colour, ms=3)
    axis.set_xticks(range(len(cars)), [car.replace("_", "\n") for car in cars])
    axis.set_ylabel("waypoints closed a minute")
    axis.set_ylim(bottom=0.0)
    tidy(axis)
    shape: dict[str, Any] = {"color": MEASURED_COLOUR, "marker": "o", "ls": ""}
    handles = [Line2D([], [], color=COLOURS[n], lw=4, label=arm) for n, arm in enumerate(arms)]
    handles += [Line2D([], [], mfc="white", label="in its simulator", **shape)]
    handles += [Line2D([], [], label="on the car", **shape)]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), frameon=False)
    return figure
