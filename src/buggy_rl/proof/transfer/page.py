"""The page of the study and its figure, from the two tables alone."""

from collections.abc import Mapping
from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from buggy_rl.core.files import write_atomically
from buggy_rl.figures.style import COLOURS, FAINT, PRINTED, tidy
from buggy_rl.proof.markdown import page_of
from buggy_rl.proof.transfer.arms import ARMS
from buggy_rl.proof.transfer.plan import TransferConfig
from buggy_rl.proof.transfer.score import (
    GIVEN,
    Losses,
    MeanOverCars,
    Pair,
    carried,
    drawn_means,
    losses,
    pairs,
    targets,
)
from buggy_rl.proof.transfer.tables import read_tables

PICTURE = "transfer.png"


def write_page(config: TransferConfig, command: str) -> Path:
    """Writes page and figure from the tables in `output`; the page.

    Args:
        config: Of the study.
        command: That makes them again.

    Raises:
        ValueError: The tables are missing, or incomplete.
    """
    folder = Path(config.output)
    drives, cars = read_tables(folder)
    found = losses(drives, cars)
    figure = transfer_figure(found, cars)
    figure.savefig(folder / PICTURE, dpi=PRINTED)
    plt.close(figure)
    file = folder / "transfer.md"
    write_atomically(file, transfer_page(config, drives, cars, command))
    return file


def transfer_page(
    config: TransferConfig, drives: pd.DataFrame, cars: pd.DataFrame, command: str
) -> str:
    """The whole page as Markdown; arguments as of `write_page`, tables as of `read_tables`."""
    found = losses(drives, cars)
    arms = found.arms
    return page_of(
        "buggy_rl.proof.transfer",
        "transfer.md.jinja",
        config=config,
        command=command,
        picture=PICTURE,
        arms=arms,
        meaning={name: ARMS[name].meaning for name in arms},
        seeds=drives.seed.nunique(),
        found=found,
        targets=targets(found, drives),
        means=_means(found, drives),
        pairs=[_pair(pair) for pair in pairs(found)],
        carried=carried(found),
        by_car=_by_car(found),
        by_course=_by_course(drives, found),
        said=cars.replace({"concealed": {"": "nothing"}, "named": {"": "nothing"}}),
    )


def _means(found: Losses, drives: pd.DataFrame) -> list[list[str]]:
    """A row for each arm."""
    draws, changed = drawn_means(found), found.changed
    corrected, lost = found.corrected.mean(), found.lost
    rows = []
    for arm in found.arms:
        here = drives[drives.car.isin(changed) & (drives.arm == arm)]
        there = MeanOverCars.of(found.there.loc[changed, arm].mean(), draws.there[arm])
        control = lost.loc[found.controls, arm].mean()
        rows.append(
            [
                arm,
                f"{found.own.loc[changed, arm].mean():.1f}",
                f"{there}",
                f"{lost.loc[changed, arm].mean():.1f}",
                f"{control:.1f}" if found.controls else "-",
                f"{MeanOverCars.of(corrected[arm], draws.corrected[arm])}",
                f"{here.lateral.mean():.3f}",
                f"{here.put_back.mean():.1f}",
                f"{here.seconds.mean():.0f}",
            ]
        )
    return rows


def _pair(pair: Pair) -> list[str]:
    return [
        pair.arm,
        f"{pair.closed}",
        f"{pair.closed_p:.2g}",
        f"{pair.corrected}",
        f"{pair.corrected_p:.2g}",
    ]


def _by_car(found: Losses) -> list[list[str]]:
    """A row for each car: on it, and in the own simulator."""
    there, own = (table.to_numpy().tolist() for table in (found.there, found.own))
    return [
        [str(car), *(f"{on:.0f} ({at:.0f})" for on, at in zip(*rows, strict=True))]
        for car, *rows in zip(found.there.index, there, own, strict=True)
    ]


def _by_course(drives: pd.DataFrame, found: Losses) -> list[list[str]]:
    """A row for each path: what is lost there on changed cars."""
    here = drives[drives.car.isin(found.changed)]
    lost = here.assign(lost=here.own - here.there).pivot_table("lost", "course", "arm", sort=False)
    courses, cells = lost.index.tolist(), lost[found.arms].to_numpy().tolist()
    return [
        [course, *(f"{value:.1f}" for value in row)]
        for course, row in zip(courses, cells, strict=True)
    ]


def transfer_figure(found: Losses, cars: pd.DataFrame) -> Figure:
    """A column for each arm, a row for each car; waypoints a minute.

    An open circle is the own simulator, a dot the car, the line between them the loss. The grey
    mark is the car with the policy as given. Controls are below the line.
    """
    arms, rows = found.arms, [*found.changed, *found.controls]
    figure, axes = plt.subplots(
        1,
        len(arms),
        figsize=(2.6 + 1.25 * len(arms), 1.2 + 0.24 * len(rows)),
        sharey=True,
        sharex=True,
        squeeze=False,
        layout="constrained",
    )
    for number, (arm, axis) in enumerate(zip(arms, axes[0], strict=True)):
        _column(axis, found, arm, rows, COLOURS[number % len(COLOURS)])
    labels = _labels(cars)
    axes[0, 0].set_yticks(range(len(rows)), [labels[car] for car in rows])
    axes[0, 0].set_ylim(len(rows) - 0.5, -0.5)
    figure.supxlabel(
        "waypoints a minute: on the car (dot), in the own simulator (circle), on the car as given "
        "(grey)",
        size=9,
    )
    return figure


def _column(axis: Axes, found: Losses, arm: str, rows: list[str], colour: str) -> None:
    own, there = (table.loc[rows, arm].tolist() for table in (found.own, found.there))
    places = list(range(len(rows)))
    if GIVEN in found.arms:
        axis.plot(found.there.loc[rows, GIVEN], places, "|", color=FAINT, ms=9, mew=1.5)
    axis.hlines(places, own, there, color=colour, lw=2.0, alpha=0.35)
    axis.plot(own, places, "o", color=colour, mfc="white", ms=4)
    axis.plot(there, places, "o", color=colour, ms=4)
    if found.controls:
        axis.axhline(len(found.changed) - 0.5, color=FAINT, lw=0.8)
    axis.set_title(arm.replace("_", "\n"), size=9)
    axis.tick_params(axis="y", length=0)
    tidy(axis)


def _labels(cars: pd.DataFrame) -> Mapping[str, str]:
    """What a car is called: its number, and the effects concealed in it."""
    hidden = (text.split("; ") if text else [] for text in cars.concealed)
    effects = [", ".join(part.split()[0] for part in parts) for parts in hidden]
    return {
        car: f"{named or 'nothing'} {car}" for car, named in zip(cars.car, effects, strict=True)
    }
