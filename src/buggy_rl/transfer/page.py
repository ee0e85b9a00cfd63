"""The page that shows the drives of all policies, as Markdown."""

from collections.abc import Mapping
from typing import Any

import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined

from buggy_rl.transfer.plan import ARMS, TransferConfig
from buggy_rl.transfer.score import counted, means, original_loss, over_seeds, targets


def page(
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
        loader=PackageLoader("buggy_rl.transfer", ""),
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
    share = means(drives, "arm").eval("100 * lost / own")
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
