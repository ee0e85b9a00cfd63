"""What a diagnosis of a black box says of a plant whose friction was cut."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import torch
from benchmarks.resumed import appended, rows_of

TRUTH = "tire_grip"
SURE, CLOSE = 0.9, 0.1  # [-] probability, and relative error of the number, of the target
SPARE = 0.1  # [s] driven beyond what is asked for
COLUMNS = (
    *("plant", "grip", "seed", "verdict", "first", "probability"),
    *("grip_said", "error", "of_the_truth", "met", "seconds"),
)


@dataclass(frozen=True)
class NamedConfig:
    """Which cases."""

    plants: list[str] = field(
        default_factory=lambda: ["reference", "mujoco", "contact", "commonroad"]
    )
    """Of `black_boxes`."""
    grips: list[float] = field(default_factory=lambda: [0.4, 0.6, 0.8])
    """True friction over the simulated."""
    seeds: list[int] = field(default_factory=lambda: [710001])
    """Of driver and camera; each is a case of every plant and grip."""
    drives: int = 2
    """Of a case."""
    seconds: float = 30.0
    """Length of each."""
    output: str = "benchmarks/results/grip_named.csv"
    """CSV of the cases; those in it are not run again."""


Case = tuple[str, float, int]
"""Plant, grip and seed."""


def cases(config: NamedConfig) -> list[Case]:
    """All of them, one of every plant and grip before the next seed."""
    return [(p, g, s) for s in config.seeds for g in config.grips for p in config.plants]


def written(file: Path) -> list[dict[str, str]]:
    """Rows of the output."""
    return rows_of(file, COLUMNS)


def left(config: NamedConfig) -> list[Case]:
    """Cases that are not in the output."""
    done = {(r["plant"], float(r["grip"]), int(r["seed"])) for r in written(Path(config.output))}
    return [case for case in cases(config) if case not in done]


def measured(config: NamedConfig) -> Iterator[dict[str, Any]]:
    """Diagnoses the cases that are left, and appends each to the output."""
    for case in left(config):
        yield appended(Path(config.output), COLUMNS, diagnosed(case, config))


def diagnosed(case: Case, config: NamedConfig) -> dict[str, Any]:
    """A row: drives of the changed plant, diagnosed by the unchanged one as a black box."""
    from buggy_rl.diagnosis.config import DiagnosisConfig
    from buggy_rl.diagnosis.pipeline import run_diagnosis

    asked = DiagnosisConfig(
        simulator=f"{Path(__file__).with_name('black_boxes.py')}:{case[0]}",
        recordings=[""],
        output="",
        workers=1,
    )
    begun = time.monotonic()
    answer = run_diagnosis(asked, recorded(case, config)).answer
    seconds = round(time.monotonic() - begun, 1)
    return judged(case, answer.verdict, answer.effects) | {"seconds": seconds}


def judged(case: Case, verdict: str, effects: Sequence[Any]) -> dict[str, Any]:
    """What is counted of an answer: its first name, how sure, and the number of the truth."""
    plant, grip, seed = case
    own = next((e for e in effects if e.name == TRUTH), None)
    said = own.parameters["grip"].value if own else float("nan")
    first = effects[0] if effects else None
    error = abs(said / grip - 1)
    met = own is not None and first is own and own.confidence >= SURE and error <= CLOSE
    return {
        "plant": plant,
        "grip": grip,
        "seed": seed,
        "verdict": verdict,
        "first": first.name if first else "",
        "probability": round(first.confidence, 3) if first else 0.0,
        "grip_said": round(said, 4),
        "error": round(error, 4),
        "of_the_truth": round(own.confidence, 3) if own else 0.0,
        "met": int(met),
    }


@torch.no_grad()
def recorded(case: Case, config: NamedConfig) -> list[Any]:
    """Recordings of the room driver in the plant with the friction of the case."""
    from benchmarks.gripping.plants import maker
    from tensordict import TensorDict

    from buggy_rl.core.vehicle import CONTROL_PERIOD
    from buggy_rl.policies.controllers.recording import recorded_steps
    from buggy_rl.policies.controllers.room import RoomDriver
    from buggy_rl.recordings import Recording
    from buggy_rl.recordings.camera import Camera

    plant, grip, seed = case
    steps = round((config.seconds + SPARE) / CONTROL_PERIOD)
    rows = list(recorded_steps(maker(plant, grip)(config.drives), RoomDriver(seed=seed), steps))
    true, camera = cast(TensorDict, TensorDict.stack(rows, 1)), Camera(seed=seed)
    return [
        Recording(f"drive_{index}", camera.recorded(drive), CONTROL_PERIOD)
        for index, drive in enumerate(true.unbind(0))
    ]


def table(rows: Sequence[dict[str, str]]) -> str:
    """By plant and over all, as Markdown."""
    lines = [
        "| plant | cases | first | first and 0.9 sure | and within 10 % | median error |",
        "|---|--:|--:|--:|--:|--:|",
    ]
    plants = list(dict.fromkeys(r["plant"] for r in rows))
    for name in (*plants, "all"):
        own = [r for r in rows if name in (r["plant"], "all")]
        first = [r for r in own if r["first"] == TRUTH]
        sure = [r for r in first if float(r["probability"]) >= SURE]
        met = sum(int(r["met"]) for r in own)
        off = torch.tensor([float(r["error"]) for r in own if r["error"] != "nan"])
        median = f"{100 * float(off.quantile(0.5)):.1f} %" if len(off) else "-"
        lines.append(f"| {name} | {len(own)} | {len(first)} | {len(sure)} | {met} | {median} |")
    return "\n".join(lines)
