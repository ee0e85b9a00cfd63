"""Ambiguous cases, their suggested manoeuvre, and what it decides."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from benchmarks.resumed import appended, rows_of

from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.diagnosis.answer.experiments import SUGGESTED
from buggy_rl.diagnosis.answer.manoeuvres import MANOEUVRES, TIMES
from buggy_rl.diagnosis.search.posterior import SURE
from buggy_rl.policies.controllers.replay import ReplayDriver
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.drives import drive_cases, plant_of, true_drive
from buggy_rl.proof.cases.simulators import recorded_case_drive as recorded
from buggy_rl.recordings import Recording

NUMBERS = {  # what is concealed, each easily taken for another of them in poor drives
    "viscous_drag": {"rate": 0.1},
    "aerodynamic_drag": {"coefficient": 0.05},
    "throttle_gain": {"gain": 0.9},
    "payload": {"mass_ratio": 1.15},
    "steering_dead_time": {"dead_time": 0.02},
    "steering_lag": {"time_constant": 0.02},
    "motor_power_limit": {"power_per_mass": 9.0},
    "rolling_resistance": {"deceleration": 0.15},
    "steering_gain": {"gain": 0.95},
    "grip_balance": {"front_to_rear": 0.85},
    "one_sided_drag": {"yaw_acceleration": 1.0},
    "steering_offset": {"offset": 0.03},
    "throttle_deadband": {"width": 0.04},
    "top_speed": {"speed_ratio": 0.85},
    "throttle_offset": {"offset": -0.08},
}
NOISE = 200  # number of the first manoeuvre drive, behind those of all other drives
COLUMNS = (
    *("truth", "driving", "seed", "before", "probability_before", "between", "manoeuvre"),
    *("predicted", "after", "probability_after", "decided", "wrong"),
)


@dataclass(frozen=True)
class DecidingConfig:
    """Which cases."""

    effects: list[str] = field(default_factory=lambda: list(NUMBERS))
    """What is concealed, one at a time; all of `NUMBERS` are to choose from."""
    driving: list[str] = field(default_factory=lambda: ["steady", "timid"])
    """Drivers that leave much open."""
    seeds: list[int] = field(default_factory=lambda: [720001])
    """Of driver and camera."""
    seconds: float = 12.0
    """Length of each of the two drives."""
    stretches: int = 60
    """Most segments of a diagnosis."""
    output: str = "benchmarks/results/manoeuvres.csv"
    """CSV of the cases; those in it are not run again."""


Key = tuple[str, str, int]
"""Effect, driver and seed."""


def written(file: Path) -> list[dict[str, str]]:
    """Rows of the output."""
    return rows_of(file, COLUMNS)


def left(config: DecidingConfig) -> list[Key]:
    """Cases that are not in the output."""
    done = {(r["truth"], r["driving"], int(r["seed"])) for r in written(Path(config.output))}
    every = [(e, d, s) for s in config.seeds for d in config.driving for e in config.effects]
    return [key for key in every if key not in done]


def measured(config: DecidingConfig) -> Iterator[dict[str, Any]]:
    """Runs the cases that are left, and appends each to the output."""
    for key in left(config):
        yield appended(Path(config.output), COLUMNS, row(key, config))


def row(key: Key, config: DecidingConfig) -> dict[str, Any]:
    """A case: diagnosed, and again with the manoeuvre that most probably decides."""
    truth, driving, seed = key
    case = Case(
        seed,
        "reference",
        "reference",
        concealed={truth: NUMBERS[truth]},
        driving=driving,
        seconds=config.seconds,
        drives=2,
        held_out=0,
    )
    drives = [
        recorded(case, d, True, n) for n, d in enumerate(drive_cases([case])[0].changed.unbind(0))
    ]
    before = _diagnosed(drives, config)
    result = {"truth": truth, "driving": driving, "seed": seed, **_said(before, truth, "before")}
    if not before.manoeuvres:
        return result
    best = before.manoeuvres[0]
    result |= {
        "between": " or ".join("+".join(e) or "nothing" for e in best.between),
        "manoeuvre": best.manoeuvre,
        "predicted": round(best.rate, 3),
    }
    after = _diagnosed([*drives, *_manoeuvre(case, best.manoeuvre)], config)
    sure = [e.name for e in after.effects if e.confidence >= SURE]
    decided, wrong = truth in sure, bool({*sure} - {truth})
    result |= _said(after, truth, "after")
    return result | {"decided": int(decided), "wrong": int(wrong)}


def _said(answer: Any, truth: str, when: str) -> dict[str, Any]:
    said = answer.effects[0].name if answer.effects else answer.verdict
    return {when: said, f"probability_{when}": round(answer.posterior.of(truth), 3)}


def _diagnosed(drives: Sequence[Recording], config: DecidingConfig) -> Any:
    from buggy_rl.diagnosis.config import DiagnosisConfig
    from buggy_rl.diagnosis.pipeline import run_diagnosis

    asked = DiagnosisConfig(
        simulator="reference",
        recordings=[""],
        output="",
        effects=list(NUMBERS),
        parameters=False,
        stretches=config.stretches,
        workers=1,
    )
    return run_diagnosis(asked, drives).answer


@torch.no_grad()
def _manoeuvre(case: Case, name: str) -> list[Recording]:
    """The manoeuvre in the concealed car, `TIMES` times, headings spread around the compass."""
    [manoeuvre] = [m for m in MANOEUVRES if m.name == name]
    actions, pose = manoeuvre.actions(CONTROL_PERIOD), torch.zeros(TIMES, 3)
    pose[:, 2] = torch.arange(TIMES) * 2 * torch.pi / TIMES - torch.pi
    plant = plant_of(case, TIMES, case.faults)
    true = true_drive(plant, ReplayDriver(actions), pose, len(actions))
    return [recorded(case, d, True, NOISE + n) for n, d in enumerate(true.unbind(0))]


def table(rows: Sequence[dict[str, str]]) -> str:
    """As Markdown: predicted and achieved decision rates."""
    open_ = [r for r in rows if r["manoeuvre"]]
    groups = {
        "undecided, best manoeuvre driven": open_,
        f"of these, suggested (predicted at least {SUGGESTED:g})": [
            r for r in open_ if float(r["predicted"]) >= SUGGESTED
        ],
        "of these, the truth among the leading hypotheses": [
            r for r in open_ if r["truth"] in r["between"].split(" or ")
        ],
    }
    lines = [
        f"{len(rows)} cases, {len(rows) - len(open_)} decided at once",
        "",
        "| cases | number | predicted | decided right | another name 0.9 sure |",
        "|---|--:|--:|--:|--:|",
    ]
    for name, own in groups.items():
        if own:
            mean = sum(float(r["predicted"]) for r in own) / len(own)
            right, wrong = (sum(int(r[k]) for r in own) / len(own) for k in ("decided", "wrong"))
            lines.append(f"| {name} | {len(own)} | {mean:.0%} | {right:.0%} | {wrong:.0%} |")
    return "\n".join(lines)
