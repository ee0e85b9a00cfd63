"""study.html: a whole study as one file that needs no other and no network.

The page shows what the stages have written, read back; nothing is computed anew.
"""

import base64
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from jinja2 import Environment, PackageLoader, PrefixLoader, StrictUndefined
from numpy.typing import NDArray

from buggy_rl.diagnosis.answer.answer import worth_saying
from buggy_rl.diagnosis.repair.layers import Layer, by_seconds
from buggy_rl.diagnosis.report.page import Step, steps_of
from buggy_rl.estimation.fit_study import StudyDrives
from buggy_rl.estimation.open_loop import MEASURED, Rollouts, load_rollouts
from buggy_rl.figures.models import RAMP
from buggy_rl.figures.style import COLOURS, MEASURED_COLOUR
from buggy_rl.jobs import read_outcome
from buggy_rl.visual.study.figures import FIGURES
from buggy_rl.visual.study.stages import Stage, StudyPlan

ROOM = ("lap", "infinity", "random")  # courses over which the original study averages its loss


@dataclass(frozen=True)
class Ran:
    """A stage as it was run."""

    name: str
    title: str
    command: str
    seconds: float


def _ran(stages: Sequence[Stage]) -> list[Ran]:
    """The stages with their commands and run times, in order."""
    result = []
    for stage in stages:
        seconds = read_outcome(stage.job.folder).get("seconds", 0.0)
        script, *arguments = stage.job.command
        command = " ".join(["python", f"scripts/{Path(script).name}", *arguments])
        result.append(Ran(stage.job.name, stage.title, command, seconds))
    return result


def _recordings(drives: StudyDrives) -> list[dict[str, Any]]:
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


def _simulators(folder: Path) -> list[dict[str, Any]]:
    """Rows of table.csv, smallest 1 s error first."""
    table = pd.read_csv(folder / "table.csv").sort_values("position_mse_1s")
    return table.to_dict("records")  # pyrefly: ignore[bad-return]


def _fitted_parameters(file: Path) -> list[dict[str, Any]]:
    """The fitted parameters: name, value, low, high, unit, started_from, warnings."""
    content = yaml.safe_load(file.read_text())
    return [
        {"name": name, "value": content["parameters"][name], **about}
        for name, about in content["_fit"].items()
    ]


def _policies(folder: Path) -> list[dict[str, Any]]:
    """Rows of policies.csv; empty if none were trained."""
    file = folder / "policies" / "policies.csv"
    if not file.is_file():
        return []
    return pd.read_csv(file).to_dict("records")  # pyrefly: ignore[bad-return]


def _transfer(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
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


REPAIRED = "repaired by the diagnosis"


def _with_repaired(folder: Path, table: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of all simulators and of the repaired one, over the same held-out segments."""
    rows = {row["simulator"]: row for row in _simulators(folder / "repair")}
    own = [{**rows["repaired"], "simulator": REPAIRED}] if "repaired" in rows else []
    return sorted([*table, *own], key=lambda row: row["position_mse_1s"])


def _steps(diagnosis: Mapping[str, Any]) -> list[Step]:
    """Steps of the repair, from the simulator as given down to the noise; none without layers."""
    layers = [Layer.of(entry) for entry in diagnosis.get("layers", [])]
    if not layers:
        return []
    medians = diagnosis["fit"]["position_median"]
    return steps_of(layers, {name: by_seconds(values) for name, values in medians.items()})


def _named(diagnosis: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The effects that the report of the diagnosis says."""
    verdict, effects = diagnosis["verdict"], diagnosis["effects"]
    return [e for e in effects if worth_saying(verdict, e["kind"], e["confidence"])]


def _read_diagnosis(folder: Path) -> dict[str, Any]:
    """Reads diagnosis.json."""
    return json.loads((folder / "diagnosis" / "diagnosis.json").read_text())


SHOWN = 40  # segments, of which a study has hundreds; chosen for the size of the page
SECONDS = 2.0  # of each
HORIZON = 1.0  # [s] at which a segment's error is told
MILLIMETRES = 3  # decimals of a position; of an angle 3 too
FARTHEST = 50.0  # [m] from the start, beyond which a diverged simulator is cut off


def player(rollouts: Rollouts, simulators: Sequence[str]) -> dict[str, Any]:
    """Segments spread evenly over the held-out recordings.

    Args:
        rollouts: Of the study's table.
        simulators: Those shown, in this order.

    Returns:
        `time` [K] s; `segments`, each with `recording`, `measured` [K][3], `made` (simulator ->
        [K'][3], K' <= K where it diverges) and `error` (simulator -> m after `HORIZON`, None where
        it is not finite).
    """
    kept = rollouts.time <= SECONDS + 1e-9
    count = len(rollouts.recording)
    chosen = np.unique(np.linspace(0, count - 1, min(SHOWN, count)).round().astype(int))
    row = int(np.abs(rollouts.time - HORIZON).argmin())
    segments = []
    for index in chosen.tolist():
        measured = rollouts.pose[MEASURED][index]
        made = {name: rollouts.pose[name][index] for name in simulators}
        segments.append(
            {
                "recording": rollouts.recording[index],
                "measured": _listed(measured[kept]),
                "made": {name: _listed(pose[kept]) for name, pose in made.items()},
                "error": {name: _error(pose[row], measured[row]) for name, pose in made.items()},
            }
        )
    return {"time": np.round(rollouts.time[kept], 3).tolist(), "segments": segments}


def _listed(pose: NDArray[Any]) -> list[list[float]]:
    """Rows up to the first that is not finite or too far away."""
    away = np.hypot(*(pose[:, :2] - pose[0, :2]).T)
    bad = ~np.isfinite(pose).all(1) | (away > FARTHEST)
    end = int(bad.argmax()) if bad.any() else len(pose)
    return np.round(pose[:end].astype(float), MILLIMETRES).tolist()


def _error(made: NDArray[Any], measured: NDArray[Any]) -> float | None:
    """Distance between two poses [m]."""
    distance = float(np.hypot(*(made - measured)[:2]))
    return round(distance, 4) if np.isfinite(distance) else None


TYPES = {".png": "image/png", ".mp4": "video/mp4", ".svg": "image/svg+xml"}
PLAYED = 5  # simulators in the player: the best ones, the fitted and the one as shipped
LARGEST = 400_000  # [byte] of a picture or film that is put into the page
CAPTIONS = {name: (draw.__doc__ or name).splitlines()[0] for name, draw in FIGURES.items()} | {
    "policy": "A policy trained in the fitted simulator; the ghost is pure pursuit."
}


@dataclass(frozen=True)
class Made:
    """How the study was made."""

    command: str
    commit: str
    date: str


def study_page(plan: StudyPlan, drives: StudyDrives, stages: Sequence[Stage], made: Made) -> str:
    """The page, from what the stages have written.

    Args:
        plan: Of the study, all stages run.
        drives: Its recordings.
        stages: In the order in which they were run.
        made: For the foot of the page.

    Returns:
        HTML.
    """
    folder, config = plan.folder, plan.config
    table = _simulators(folder)
    fitted = f"{config.fit_simulator}, fitted"
    policies, diagnosis = _policies(folder), _read_diagnosis(folder)
    repair = _with_repaired(folder, table)
    errors = {row["simulator"]: row["position_mse_1s"] for row in repair}
    return (
        _templates()
        .get_template("study/study.html.jinja")
        .render(
            title=config.title or folder.name,
            made=made,
            stages=_ran(stages),
            recordings=_recordings(drives),
            simulators=table,
            fitted=fitted,
            parameters=_fitted_parameters(plan.fitted),
            policies=policies,
            driven=_driven(policies),
            transfer=_transfer(policies),
            diagnosis=diagnosis,
            named=_named(diagnosis),
            steps=_steps(diagnosis),
            shipped=config.diagnosed == "shipped",
            repair=repair,
            repaired=REPAIRED,
            no_better=errors.get(REPAIRED, 0.0) >= errors.get(fitted, math.inf),
            played=_played(folder, table, fitted),
            pictures=embedded([folder / "figures" / f"{name}.png" for name in FIGURES], CAPTIONS),
            films=embedded(sorted((folder / "films").glob("*.mp4")), CAPTIONS),
        )
    )


def embedded(files: Sequence[Path], captions: Mapping[str, str]) -> dict[str, str]:
    """Caption -> data URI of each file that is there and not too large for the page.

    Args:
        files: Pictures and films.
        captions: Stem of a file -> what it shows; a stem that is not there stands for itself.
    """
    return {
        captions.get(file.stem, file.stem.replace("_", " ")): _data_uri(file)
        for file in files
        if file.exists() and file.stat().st_size <= LARGEST
    }


def _data_uri(file: Path) -> str:
    content = base64.b64encode(file.read_bytes()).decode()
    return f"data:{TYPES[file.suffix]};base64,{content}"


def _played(folder: Path, table: Sequence[Mapping[str, Any]], fitted: str) -> str:
    """The player's data as JSON that can stand in a script element."""
    names = [row["simulator"] for row in table]
    shown = list(dict.fromkeys([*names[: PLAYED - 1], *(n for n in names if n == fitted)]))
    content = player(load_rollouts(folder / "rollouts.npz"), shown)
    content |= {"colours": COLOURS, "colour_measured": MEASURED_COLOUR, "ramp": RAMP}
    return json.dumps(content, separators=(",", ":")).replace("<", "\\u003c")


def _driven(policies: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Waypoints by (policy, place) and course, for a table."""
    courses = list(dict.fromkeys(row["course"] for row in policies))
    cells = {(r["policy"], r["place"], r["course"]): r["waypoints"] for r in policies}
    pairs = list(dict.fromkeys((r["policy"], r["place"]) for r in policies))
    rows = [(*pair, [cells.get((*pair, course)) for course in courses]) for pair in pairs]
    return {"courses": courses, "rows": rows}


def _templates() -> Environment:
    loader = PrefixLoader(
        {
            "study": PackageLoader("buggy_rl.visual.study", ""),
            "report": PackageLoader("buggy_rl.diagnosis.report", ""),
        }
    )
    return Environment(
        loader=loader,
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=StrictUndefined,
    )
