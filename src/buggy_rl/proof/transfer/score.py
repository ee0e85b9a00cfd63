"""What the drives show: losses, paired differences over cars, and the targets of the study.

A car is the unit; its seeds and paths are averaged first. Lost is what a policy closes in its own
simulator less what it closes on the car. Corrected is that less what policies of the same arm lose
on the cars with nothing wrong that the arm was made for: what any simulator loses.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.stats import wilcoxon

CURED = 0.2  # share of the loss as given that the repaired policy may have
REACHED = 0.95  # share of the repaired policy's gain that one that is trained on must have
RESAMPLES = 10_000
SEED = 0
REPAIRED, GIVEN, TRUTH, CONTINUED = "repaired", "as_given", "truth", "continued"


@dataclass(frozen=True, eq=False)
class Losses:
    """Waypoints a minute by car (rows) and arm (columns)."""

    own: pd.DataFrame
    there: pd.DataFrame
    changed: list[str]
    """Cars in which something is concealed."""
    controls: list[str]
    """Cars with nothing wrong."""

    @property
    def lost(self) -> pd.DataFrame:
        """Lost from simulator to car, of all cars."""
        return self.own - self.there

    @property
    def corrected(self) -> pd.DataFrame:
        """Lost by changed cars beyond the mean of the controls; not corrected without controls."""
        lost = self.lost
        if not self.controls:
            return lost.loc[self.changed]
        return lost.loc[self.changed] - lost.loc[self.controls].mean()

    @property
    def arms(self) -> list[str]:
        """All arms, in their order."""
        return [str(arm) for arm in self.there.columns]

    def without(self, car: str) -> "Losses":
        """The study without a changed car."""
        changed = [name for name in self.changed if name != car]
        return Losses(self.own, self.there, changed, self.controls)


def losses(drives: pd.DataFrame, cars: pd.DataFrame) -> Losses:
    """Means of every car and arm.

    Args:
        drives: From `tables.read_tables`,
        cars: likewise.

    Raises:
        ValueError: No car has something wrong, or an arm was not driven on some car.
    """
    own, there = (
        drives.pivot_table(column, "car", "arm", sort=False) for column in ("own", "there")
    )
    if there.isna().any(axis=None):
        lacking = there.index[there.isna().any(axis=1)].tolist()
        raise ValueError(f"cars {lacking} lack drives of some arms: run the stages before page")
    right = set(cars.car[cars.concealed == ""])
    driven = [str(car) for car in there.index]
    changed = [car for car in driven if car not in right]
    if not changed:
        raise ValueError("no car has something wrong: draw more cars")
    return Losses(own, there, changed, [car for car in driven if car in right])


@dataclass(frozen=True, eq=False)
class DrawnMeans:
    """Means over cars drawn with replacement, [RESAMPLES] rows, arms as columns.

    Changed cars and controls are drawn apart from each other.
    """

    there: pd.DataFrame
    corrected: pd.DataFrame


def drawn_means(found: Losses) -> DrawnMeans:
    """Bootstrap over cars; the same numbers every time."""
    chance = np.random.default_rng(SEED)
    lost = found.lost

    def means(table: pd.DataFrame, rows: np.ndarray) -> np.ndarray:
        return table.to_numpy()[rows].mean(1)

    def rows(cars: list[str]) -> np.ndarray:
        return chance.integers(0, len(cars), (RESAMPLES, len(cars)))

    changed = rows(found.changed)
    corrected = means(lost.loc[found.changed], changed)
    if found.controls:
        corrected = corrected - means(lost.loc[found.controls], rows(found.controls))
    there = means(found.there.loc[found.changed], changed)
    arms = found.there.columns
    return DrawnMeans(pd.DataFrame(there, columns=arms), pd.DataFrame(corrected, columns=arms))


@dataclass(frozen=True)
class MeanOverCars:
    """A mean over cars with its 95 % interval."""

    mean: float
    low: float
    high: float

    @classmethod
    def of(cls, mean: float, draws: pd.Series) -> "MeanOverCars":
        """Makes one by the draws of a bootstrap."""
        low, high = np.nanquantile(draws, (0.025, 0.975))
        return cls(float(mean), float(low), float(high))

    def __str__(self) -> str:
        return f"{self.mean:.1f} ({self.low:.1f} to {self.high:.1f})"


@dataclass(frozen=True)
class Pair:
    """The repaired policy less that of another arm, over cars."""

    arm: str
    closed: MeanOverCars
    """Waypoints a minute on the car."""
    closed_p: float
    """Value of p by Wilcoxon's signed-rank test; nan where all differences are 0."""
    corrected: MeanOverCars
    """Corrected loss [1/min]."""
    corrected_p: float


def pairs(found: Losses) -> list[Pair]:
    """Repaired against every other arm; none without it."""
    there, corrected, draws = found.there.loc[found.changed], found.corrected, drawn_means(found)
    arms = [arm for arm in found.arms if arm != REPAIRED and REPAIRED in found.arms]
    rows = []
    for arm in arms:
        values: list = []
        for table, drawn in ((there, draws.there), (corrected, draws.corrected)):
            difference = table[REPAIRED] - table[arm]
            spread = drawn[REPAIRED] - drawn[arm]
            values += [MeanOverCars.of(difference.mean(), spread), signed_rank(difference)]
        rows.append(Pair(arm, *values))
    return rows


def signed_rank(differences: pd.Series) -> float:
    """Two-sided p of Wilcoxon's signed-rank test; nan where all differences are 0."""
    if not differences.any():
        return float("nan")
    return float(wilcoxon(differences.to_numpy()).pvalue)


@dataclass(frozen=True)
class Target:
    """What the study has to show."""

    sentence: str
    met: bool


def targets(found: Losses, drives: pd.DataFrame) -> list[Target]:
    """What the study has to show, and whether it does; those whose arms there are."""
    arms = set(found.arms)
    listed = []
    if {REPAIRED, GIVEN} <= arms:
        listed.append(_cured(found))
    if REPAIRED in arms and arms - {REPAIRED, TRUTH}:
        listed.append(_closes_most(found))
    if {REPAIRED, GIVEN, CONTINUED} <= arms:
        listed.append(_trained_on(found, drives))
    return listed


def _cured(found: Losses) -> Target:
    mean, draws = found.corrected.mean(), drawn_means(found).corrected
    beyond = MeanOverCars.of(
        mean[REPAIRED] - CURED * mean[GIVEN], draws[REPAIRED] - CURED * draws[GIVEN]
    )
    sentence = (
        f"Repaired, policies lose {mean[REPAIRED]:.1f} waypoints a minute beyond their control, at "
        f"most a fifth of the {mean[GIVEN]:.1f} as given; less that fifth it is {beyond}, which "
        "must end below 0."
    )
    return Target(sentence, bool(mean[GIVEN] > 0 and beyond.high <= 0))


def _closes_most(found: Losses) -> Target:
    there = found.there.loc[found.changed].mean()
    others = there.drop([REPAIRED, TRUTH], errors="ignore")
    best = str(others.idxmax())
    sentence = (
        f"They close {there[REPAIRED]:.1f} a minute on the car, at least as many as those of every "
        f"arm but {TRUTH} (the best: {best}, {others[best]:.1f})."
    )
    return Target(sentence, bool(there[REPAIRED] >= others[best]))


def _trained_on(found: Losses, drives: pd.DataFrame) -> Target:
    there, draws = found.there.loc[found.changed].mean(), drawn_means(found).there
    gain, drawn = there[REPAIRED] - there[GIVEN], draws[REPAIRED] - draws[GIVEN]
    share = (there[CONTINUED] - there[GIVEN]) / gain if gain else float("nan")
    spread = ((draws[CONTINUED] - draws[GIVEN]) / drawn.where(drawn != 0)).fillna(0.0)
    percent = MeanOverCars.of(100 * share, 100 * spread)
    sentence = (
        f"Policies of as_given that are trained on in the repaired simulator have {percent} % of "
        f"the {gain:.1f} waypoints a minute that training anew there gains, at least "
        f"{100 * REACHED:.0f} %, by {_cost(drives, CONTINUED)} for {_cost(drives, REPAIRED)}."
    )
    return Target(sentence, bool(gain > 0 and share >= REACHED))


def _cost(drives: pd.DataFrame, arm: str) -> str:
    own = drives[drives.arm == arm]
    return f"{own.steps.mean():.0f} steps ({own.seconds.mean():.0f} s)"


@dataclass(frozen=True)
class Carried:
    """How far one car carries what the repair gains in corrected loss."""

    car: str
    share: float
    """Share of the sum over cars."""
    better: int
    """Cars that lose less repaired than as given,"""
    cars: int
    """of so many."""
    given: float
    """Corrected loss without that car, as given [1/min],"""
    repaired: float
    """and repaired."""


def carried(found: Losses) -> Carried | None:
    """The car that gains most; None without both arms, or with one car."""
    table = found.corrected
    if not {REPAIRED, GIVEN} <= set(found.arms) or len(table) < 2:
        return None
    gains = table[GIVEN] - table[REPAIRED]
    car = str(gains.idxmax())
    rest = found.without(car).corrected.mean()
    share = float(gains[car] / gains.sum())
    better = int((gains > 0).sum())
    return Carried(car, share, better, len(gains), float(rest[GIVEN]), float(rest[REPAIRED]))
