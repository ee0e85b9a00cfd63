"""What the stages have written, read back for the page; nothing is computed anew."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import yaml

from buggy_rl.estimation.fit_study import StudyDrives
from buggy_rl.jobs import read_outcome
from buggy_rl.visual.study.stages import Stage

ROOM = ("lap", "infinity", "random")  # courses over which the original study averages its loss


@dataclass(frozen=True)
class Ran:
    """A stage as it was run."""

    name: str
    title: str
    command: str
    seconds: float


def ran(stages: Sequence[Stage]) -> list[Ran]:
    """The stages with their commands and run times, in order."""
    result = []
    for stage in stages:
        seconds = read_outcome(stage.job.folder).get("seconds", 0.0)
        script, *arguments = stage.job.command
        command = " ".join(["python", f"scripts/{Path(script).name}", *arguments])
        result.append(Ran(stage.job.name, stage.title, command, seconds))
    return result


def recordings(drives: StudyDrives) -> list[dict[str, Any]]:
    """A row for each recording: name, use, seconds, top speed [m/s], what was cut."""
    used = {
        "training": drives.training,
        "validation": drives.validation,
        "held out": drives.held_out,
    }
    return [
        {
            "name": recording.name,
            "use": use,
            "seconds": recording.duration,
            "speed": float(recording.data["velocity"][:, :2].norm(dim=-1).max()),
            "notes": recording.notes,
        }
        for use, group in used.items()
        for recording in group
    ]


def simulators(folder: Path) -> list[dict[str, Any]]:
    """Rows of table.csv, smallest 1 s error first."""
    table = pd.read_csv(folder / "table.csv").sort_values("position_mse_1s")
    return table.to_dict("records")


def fitted_parameters(file: Path) -> list[dict[str, Any]]:
    """The fitted parameters: name, value, low, high, unit, started_from, warnings."""
    content = yaml.safe_load(file.read_text())
    return [
        {"name": name, "value": content["parameters"][name], **about}
        for name, about in content["_fit"].items()
    ]


def policies(folder: Path) -> list[dict[str, Any]]:
    """Rows of policies.csv; empty if none were trained."""
    file = folder / "policies" / "policies.csv"
    return pd.read_csv(file).to_dict("records") if file.is_file() else []


def transfer(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Waypoints that a policy loses between its own simulator and another place.

    Mean over lap, infinity and the random path in the room, as the original study has it.
    """
    closed = {(r["policy"], r["place"], r["course"]): r["waypoints"] for r in rows}
    places = list(dict.fromkeys(r["place"] for r in rows))
    result = []
    for policy in dict.fromkeys(r["policy"] for r in rows):
        lost = {}
        for place in places:
            pairs = [((policy, policy, c), (policy, place, c)) for c in ROOM]
            known = [closed[a] - closed[b] for a, b in pairs if {a, b} <= {*closed}]
            if place != policy and known:
                lost[place] = sum(known) / len(known)
        result.append({"policy": policy, "lost": lost})
    return result


def repaired_errors(folder: Path) -> list[dict[str, Any]]:
    """The rows of the fitted and of the repaired simulator, over the same held-out segments."""
    rows = {row["simulator"]: row for row in simulators(folder / "repair")}
    return [rows[name] for name in ("fitted", "repaired") if name in rows]


def read_diagnosis(folder: Path) -> dict[str, Any]:
    """Reads diagnosis.json."""
    return json.loads((folder / "diagnosis" / "diagnosis.json").read_text())
