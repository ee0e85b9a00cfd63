"""Several cars diagnosed with one simulator, as independent jobs.

CARS/CAR/               recordings of one car
OUTPUT/CAR/             its question.yaml, and what scripts/diagnose.py writes
OUTPUT/fleet.csv        one row a car
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import yaml

from buggy_rl.core.config import plain_values
from buggy_rl.core.question import question
from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.jobs import Job, read_outcome
from buggy_rl.jobs.launching import Launching


@dataclass(frozen=True)
class FleetConfig(DiagnosisConfig, Launching):
    """One car's recordings, or a folder of cars."""

    recordings: list[str] = field(default_factory=list)
    """Files and folders that it should have predicted."""
    cars: str = ""
    """Folder, in place of recordings, that holds a folder of recordings for each car; each is
    diagnosed by itself, `workers` at a time on any launcher."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if bool(self.recordings) == bool(self.cars):
            raise ValueError("give either recordings=FOLDER of one car, or cars=FOLDER of several")

    @property
    def single(self) -> DiagnosisConfig:
        """The part that is one diagnosis."""
        return DiagnosisConfig(**{f.name: getattr(self, f.name) for f in fields(DiagnosisConfig)})


def fleet_jobs(config: FleetConfig, script: Path) -> list[Job]:
    """One job for each car.

    Args:
        config: With cars.
        script: `diagnose.py`.

    Raises:
        ValueError: The folder has no folders.
    """
    folders = sorted(f for f in Path(config.cars).glob("*") if f.is_dir())
    if not folders:
        raise ValueError(f"cars={config.cars}: no folders there; it must hold one for each car")
    return [_diagnosis(config, car, script) for car in folders]


def _diagnosis(config: FleetConfig, car: Path, script: Path) -> Job:
    folder = Path(config.output) / car.name
    # Cores are the launcher's to give: what a car's rollouts are divided among changes no answer.
    own = replace(config.single, recordings=[str(car)], output=str(folder), workers=0)
    file = folder / "question.yaml"
    return Job(
        car.name,
        folder,
        (str(script), str(file)),
        inputs=tuple(str(f) for place in (car, *map(Path, own.baseline)) for f in _files(place)),
        question=question(own, ignoring=("output", "threads", "workers", "recordings")),
        texts={file: yaml.safe_dump(plain_values(own), sort_keys=False)},
    )


def _files(place: Path) -> list[Path]:
    return [place] if place.is_file() else sorted(f for f in place.rglob("*") if f.is_file())


def fleet_rows(jobs: Sequence[Job]) -> list[dict[str, Any]]:
    """One row a car: what was found, or how its job ended."""
    return [{"car": job.name, **_answer(job.folder)} for job in jobs]


def _answer(folder: Path) -> dict[str, Any]:
    outcome, file = read_outcome(folder), folder / "diagnosis.json"
    ended = {"status": outcome.get("status", "lost"), "seconds": outcome.get("seconds")}
    if ended["status"] != "done":
        return ended
    answer = json.loads(file.read_text())
    effects, fit = answer["effects"], answer["fit"]
    return {
        **ended,
        "verdict": answer["verdict"],
        "effects": " + ".join(effect["name"] for effect in effects),
        "values": "; ".join(_values(effect) for effect in effects),
        "confidence": min((effect["confidence"] for effect in effects), default=None),
        "error_before": fit["before"],
        "error_after": fit["after"],
        "noise_floor": fit["noise_floor"],
        "unexplained": answer["unexplained"]["share"],
    }


def _values(effect: dict[str, Any]) -> str:
    found = effect["parameters"].items()
    return ", ".join(f"{effect['name']}.{name}={p['value']:.4g} {p['unit']}" for name, p in found)
