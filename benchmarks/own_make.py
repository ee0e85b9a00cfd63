"""Every effect once, concealed in a car of the simulator's make: what its equation leaves.

    python -m benchmarks.own_make
    python -m benchmarks.own_make driving=steady first=396000
    python -m benchmarks.own_make "effects=[stiff_differential,steering_drag]" "output=runs/two"

Each case has two drives of 30 s, white noise and no baseline. The true structure is fitted, begun
at the true numbers. Where the library's equation is the car's, the misfit is 1; where it is above
that in the median segment, the equation is not the car's, and a search will name something beside
it or instead. A row an effect in OUTPUT/own_make.csv; it goes on where it was interrupted.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from benchmarks.resumed import appended, rows_of

from buggy_rl.core.config import from_command_line, run
from buggy_rl.diagnosis.pipeline import open_case
from buggy_rl.estimation.gauss_newton import fitted
from buggy_rl.jobs.bar import tqdm
from buggy_rl.proof.baselines.asked import open_question
from buggy_rl.proof.calibrate.development import parts_of
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.draw import DrawConfig, drawn
from buggy_rl.proof.cases.sealing import CaseStore, seal
from buggy_rl.proof.score.oracle import ITERATIONS, at_true_numbers, true_numbers

TOGETHER = 12  # cases that are driven in one batch
COLUMNS = ("effect", "number", "true", "found", "as_given", "mean", "median", "worst")


@dataclass(frozen=True)
class OwnMakeConfig:
    """Which car, and how it is driven."""

    pairing: str = "reference"
    """Car and simulator, of `draw.PAIRINGS`: one of a car's own make."""
    driving: str = "rich"
    """rich, steady, timid or wild."""
    first: int = 395_000
    """First development seed."""
    seconds: float = 30.0
    """Length of a drive [s]."""
    effects: list[str] = field(default_factory=list)
    """Effects; empty for all that the car can have."""
    output: str = "runs/own_make"
    """Folder of the cases, and of the rows."""


def main() -> None:
    """Drives and fits what is left, and prints the rows, the worst first."""
    config = from_command_line(__doc__, "benchmarks.own_make:OwnMakeConfig")
    torch.set_num_threads(1)
    folder = Path(config.output)
    store, file = CaseStore(folder, folder / "truth"), folder / "own_make.csv"
    store.sealed.mkdir(parents=True, exist_ok=True)
    known = {row["effect"] for row in rows_of(file, COLUMNS)}
    left = [case for case in cases(config) if case.truth[0] not in known]
    undriven = [case for case in left if not store.inputs(case.id).exists()]
    for part in tqdm(parts_of(undriven, TOGETHER), "driving", unit="batch"):
        seal(store, part, [], segments=48)
    for case in tqdm(left, "fitting", unit="case"):
        for row in list(fitted_rows(store, case)):  # all of a case, or none
            appended(file, COLUMNS, row)
    for row in sorted(rows_of(file, COLUMNS), key=lambda row: -float(row["median"])):
        print("  ".join(f"{column} {row[column]}" for column in COLUMNS))


def cases(config: OwnMakeConfig) -> list[Case]:
    """A case for each effect."""
    every = DrawConfig(
        first=config.first,
        cases=0,
        each=True,
        nothing=0,
        names=config.effects,
        library="present",
        pairings=[config.pairing],
        nuisances=["white"],
        driving=[config.driving],
        seconds=[config.seconds],
        held_out=0,
    )
    return drawn(every)


def fitted_rows(store: CaseStore, case: Case) -> Iterator[dict[str, Any]]:
    """Rows of a case: one a number of its effect."""
    question = open_question(store.inputs(case.id))
    problem = open_case(question.config, question.recordings, question.baseline).problem
    numbers = true_numbers(case)
    [(effect, true)] = numbers.items()
    asked = [at_true_numbers(problem, numbers), problem.library.hypothesis(())]
    own, given = fitted(problem, asked, ITERATIONS)
    left = own.square / problem.noise.dimension
    misfit = {
        "as_given": float((given.square / problem.noise.dimension).median()),
        "mean": float(left.mean()),
        "median": float(left.median()),
        "worst": float(left.max()),
    }
    told = {name: f"{size:.3g}" for name, size in misfit.items()}
    for number, value in own.values()[effect].items():
        concealed = f"{true[number]:.4g}" if number in true else ""  # the car has no such number
        yield {
            "effect": effect,
            "number": number,
            "true": concealed,
            "found": f"{value:.4g}",
            **told,
        }


if __name__ == "__main__":
    run(main)
