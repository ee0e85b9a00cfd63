"""Cases of the round trip, and their rows."""

import random
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml
from benchmarks.resumed import appended, rows_of

from buggy_rl.diagnosis.answer.answer import Answer
from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.diagnosis.pipeline import run_diagnosis
from buggy_rl.effects import offered
from buggy_rl.proof.cases.case import BUGGY, Case
from buggy_rl.proof.cases.case import written as written_car
from buggy_rl.proof.cases.draw import (
    PAIRINGS,
    PUBLISHED,
    DrawConfig,
    case_at_scale,
    commanded,
    draw,
)
from buggy_rl.proof.cases.drives import drive_cases
from buggy_rl.proof.cases.simulators import BASELINE_NOISE, simulator_content
from buggy_rl.proof.cases.simulators import recorded_case_drive as recorded
from buggy_rl.proof.cases.sizes import CAMERA, SIZES
from buggy_rl.proof.plants import abilities
from buggy_rl.recordings import Recording

FIRST = 760_000  # seed of the first case: of no calibration
BRAKED, ONE_WAY = "reference_brakes", "reference"
PEER = (BUGGY, 100, ONE_WAY)
COLUMNS = (
    *("scale", "rate", "pairing", "seed", "truth", "first", "confidence", "right", "named"),
    *("value", "estimate", "seconds"),
)


@dataclass(frozen=True)
class RoundTripConfig:
    """Which cases."""

    scales: list[float] = field(default_factory=lambda: [1.0, 2.0, 10.0])
    """Lengths of the cars over the buggy's: 1:10, 1:5, full size."""
    rates: list[int] = field(default_factory=lambda: [20, 50, 100])
    """At which they are commanded and recorded [Hz]."""
    first: int = FIRST
    """Seed of the first case."""
    seeds: int = 4
    """Cases of each car and rate."""
    together: int = 4
    """Cases that are driven in one batch."""
    peer: bool = True
    """Whether the buggy with a one-way throttle has them too."""
    seconds: float = 30.0
    """Length of each of the two drives of a buggy; that of another car is similar."""
    window: float = 1.0
    """Length of a rollout segment of a buggy [s]; likewise."""
    stretches: int = 36
    """Most segments of a diagnosis."""
    baseline: bool = False
    """Whether two drives without the effect are given."""
    output: str = "benchmarks/results/round_trip.csv"
    """CSV of the cases; those in it are not run again."""


Cell = tuple[float, int, str]
"""Scale, rate and pairing."""


def written(file: Path) -> list[dict[str, str]]:
    """Rows of the output."""
    return rows_of(file, COLUMNS)


def left(config: RoundTripConfig) -> list[tuple[Cell, list[int]]]:
    """Cars and rates with the seeds that are not in the output, a batch each."""
    done = {
        (float(r["scale"]), int(r["rate"]), r["pairing"], int(r["seed"]))
        for r in written(Path(config.output))
    }
    cells: list[Cell] = [PEER] if config.peer else []
    cells += [(scale, rate, BRAKED) for rate in config.rates for scale in config.scales]
    every = range(config.first, config.first + config.seeds)
    parts = [every[i : i + config.together] for i in range(0, len(every), config.together)]
    open_ = [
        (c, [s for s in part if (*c, s) not in done and _has(c, effect_of(s))])
        for part in parts
        for c in cells
    ]
    return [(cell, seeds) for cell, seeds in open_ if seeds]


def measured(config: RoundTripConfig) -> Iterator[dict[str, Any]]:
    """Runs the cases that are left, and appends each to the output."""
    for cell, seeds in left(config):
        cases = [case_of(cell, seed, config) for seed in seeds]
        for case, motion in zip(cases, drive_cases(cases), strict=True):
            begun = time.process_time()
            drives = [recorded(case, d, True, n) for n, d in enumerate(motion.changed.unbind(0))]
            before = () if motion.clean is None else motion.clean.unbind(0)
            usual = [recorded(case, d, False, BASELINE_NOISE + n) for n, d in enumerate(before)]
            answer = _diagnosed(case, drives, usual, config)
            row = _row(cell, case, answer) | {"seconds": round(time.process_time() - begun, 1)}
            yield appended(Path(config.output), COLUMNS, row)


def effect_of(seed: int) -> str:
    """What is concealed: effects of every car, in an order of their own for each run of them."""
    both = abilities("reference") & set(SIZES) | set(CAMERA)
    names = sorted((both | commanded(PAIRINGS[BRAKED])) & PUBLISHED)  # of the cases in the output
    run, place = divmod(seed - FIRST, len(names))
    random.Random(run).shuffle(names)
    return names[place]


def case_of(cell: Cell, seed: int, config: RoundTripConfig) -> Case:
    """The case of a seed for one car and rate."""
    scale, rate, pairing = cell
    settings = DrawConfig(
        pairings=[pairing],
        nuisances=["white"],
        driving=["rich"],
        seconds=[config.seconds],
        held_out=0,
        rates=[rate],
    )
    able = {"reference": abilities("reference")}
    case = draw(seed, settings, able, [effect_of(seed)])
    return replace(case_at_scale(case, scale), baseline=config.baseline)


def _has(cell: Cell, effect: str) -> bool:
    """Whether the car of a cell can have an effect."""
    return cell[2] == BRAKED or effect not in commanded(PAIRINGS[BRAKED])


def _diagnosed(
    case: Case, drives: Sequence[Recording], usual: Sequence[Recording], config: RoundTripConfig
) -> Answer:
    with tempfile.TemporaryDirectory() as folder:
        simulator, car = Path(folder, "simulator.yaml"), Path(folder, "car.yaml")
        content = simulator_content(case, Path(folder))
        content.get("options", {}).pop("compiled", None)  # the kernels are sooner at it
        simulator.write_text(yaml.safe_dump(content))
        car.write_text(yaml.safe_dump(written_car(case.car)))
        asked = DiagnosisConfig(
            simulator=str(simulator),
            recordings=[""],
            output="",
            effects=offered(case.longitudinal),
            parameters=False,
            car="" if case.scale == BUGGY else str(car),
            rate=case.rate,
            seconds=config.window * case.car.similarity.time,
            stretches=config.stretches,
            minutes=0.0,
            workers=1,
        )
        return run_diagnosis(asked, drives, baseline=usual).answer


def _row(cell: Cell, case: Case, answer: Answer) -> dict[str, Any]:
    (truth, numbers), *_ = case.concealed.items()
    named = {effect.name: effect for effect in answer.effects}
    first = answer.effects[0] if answer.effects else None
    parameter = list(numbers)[-1]  # one of those of a patch, a slope, a lever arm
    own = named[truth].parameters.get(parameter) if truth in named else None
    return {
        **dict(zip(("scale", "rate", "pairing"), cell, strict=True)),
        "seed": case.seed,
        "truth": truth,
        "first": first.name if first else answer.verdict,
        "confidence": round(first.confidence, 3) if first else "",
        "right": int(first is not None and first.name == truth),
        "named": int(truth in named),
        "value": numbers[parameter],
        "estimate": "" if own is None else f"{own.value:.5g}",
    }
