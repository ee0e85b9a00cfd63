"""The simulator that a case gives to be repaired: shipped, fitted or learned, as files.

A simulator that is not shipped is fitted to, or trained on, drives of the unchanged car.
"""

import random
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from buggy_rl.blind_test.cars import BUGGY
from buggy_rl.blind_test.case import RATES, Case
from buggy_rl.blind_test.drives import moved, plant_parameters
from buggy_rl.blind_test.recorded import save_drives
from buggy_rl.effects import offered
from buggy_rl.engines import make_engine, read_simulator
from buggy_rl.engines.base import Engine
from buggy_rl.files import write_atomically
from buggy_rl.jobs import Job, run_jobs
from buggy_rl.longitudinal import ONE_WAY

PLAIN = ("reference", "mujoco")  # simulators as they are shipped; all others are prepared
COARSE = {"reference": {"substep": 0.005}, "mujoco": {"timestep": 0.005}}  # five times, twice
SLOW = {"mujoco": 60, "mujoco_fitted": 60}  # segments that are diagnosed where time counts
MODEL = "simulator.pt"
CAR = "car.yaml"  # the file of a car that is not the buggy
COLUMNS = "columns.yaml"  # the column map of drives whose command is no one-way throttle
DRIVES, SECONDS = 6, 40.0  # as many and as long as the sample drives
PREPARING = 300  # number of the first drive that a case's own simulator is fitted to
SEED = 900_000_000  # of the drives that simulators are made from: no case has it
LEARNED = (  # the history MLP of configs/demo.yaml, trained on rollouts
    "runs.model.model.kind=mlp",
    "runs.model.model.options.rows=20",
    "runs.model.model.options.hidden=[128,128]",
    "runs.model.training.weight_decay=1e-3",
)


def prepared_name(case: Case) -> str:
    """File, without its ending, that has to be prepared for a case; empty if none has."""
    if case.simulator in PLAIN:
        return ""
    own = f"_{case.id}" if case.spread else ""  # fitted anew to this very plant
    return f"{case.plant}_{case.simulator}{own}"


def simulator_content(case: Case, prepared: Path) -> dict[str, Any]:
    """What the simulator file of a case says; `prepared` holds those fitted or trained first."""
    if case.simulator == "learned":
        return {"engine": MODEL}
    if case.simulator in PLAIN:
        content: dict[str, Any] = {"engine": case.simulator}
        if case.spread:
            content["parameters"] = {n: round(v, 8) for n, v in plant_parameters(case).items()}
    else:
        file = read_simulator(prepared / f"{prepared_name(case)}.yaml")
        content = {key: value for key, value in file.items() if value}
    if content["engine"] == "reference" and shutil.which("g++"):
        content["options"] = {"compiled": True}  # the same motion, sooner
    if case.longitudinal != ONE_WAY:
        own = {"command": case.longitudinal.plain}
        content["options"] = content.get("options", {}) | own
    if case.scale != BUGGY:
        content["options"] = content.get("options", {}) | {"dimensions": dict(case.car.dimensions)}
    if case.nuisance == "integrator":
        content["options"] = content.get("options", {}) | COARSE[content["engine"]]
    if case.nuisance.startswith("parameters"):
        share = float(case.nuisance.rpartition("_")[2]) / 100
        content["parameters"] = off(content, share, case.seed)
    return content


def off(content: dict[str, Any], share: float, seed: int) -> dict[str, float]:
    """All parameters of a simulator, each up or down by a share of itself, within its range."""
    chance = random.Random(f"parameters {seed}")
    engine = make_engine(content["engine"], 1, **content.get("options", {}))
    assert isinstance(engine, Engine)
    values = {}
    for name, parameter in engine.declared.items():
        value = content.get("parameters", {}).get(name, parameter.value)
        wrong = value * (1 + chance.choice((-1, 1)) * share)
        values[name] = round(min(max(wrong, parameter.lower), parameter.upper), 8)
    return values


def unprepared(cases: Sequence[Case], folder: Path) -> list[Case]:
    """One case for each simulator that is still to be prepared."""
    found = {prepared_name(case): case for case in cases if prepared_name(case)}
    return [case for case in found.values() if not _file(folder, case).exists()]


def prepare(case: Case, folder: Path, scripts: Path) -> Path:
    """Drives the unchanged car of a case's plant and makes the simulator from that, in `folder`.

    Raises:
        ValueError: The script failed; the message holds the end of its log.
    """
    drives = folder / (f"{prepared_name(case)}_drives" if case.spread else f"{case.plant}_drives")
    if not (drives / f"drive_{DRIVES - 1}.csv").exists():
        seed = case.seed if case.spread else SEED
        car = Case(
            seed,
            case.plant,
            case.plant,
            seconds=SECONDS,
            drives=DRIVES,
            held_out=0,
            spread=case.spread,
        )
        # Noise behind that of all other drives of the case.
        numbers = {f"drive_{n}": n + (PREPARING if case.spread else 0) for n in range(DRIVES)}
        save_drives(car, moved([car])[0].changed, drives, numbers, changed=False)
    study = folder / f"{prepared_name(case)}_study"
    options = (f"data.recordings=[{drives}]", f"output={study}")
    if case.simulator == "learned":
        command = (str(scripts / "train_models.py"), *options, *LEARNED)
        made = study / "models" / "model.pt"
    else:
        engine = case.simulator.removesuffix("_fitted")
        command = (str(scripts / "fit_mujoco.py"), *options, f"fit_simulator={engine}")
        made = study / f"{engine}_fitted.yaml"
    list(run_jobs([Job(prepared_name(case), study, command)], 1))
    write_atomically(_file(folder, case), made.read_bytes())
    return _file(folder, case)


def _file(folder: Path, case: Case) -> Path:
    return folder / (prepared_name(case) + (".pt" if case.simulator == "learned" else ".yaml"))


def question(case: Case, effects: list[str], segments: int = 0) -> str:
    """Options of `scripts/diagnose.py` as YAML: all that the diagnosis is given.

    Args:
        case: Black boxes of its own make do not show their parameters.
        effects: To choose from; empty for the whole library.
        segments: Of the drives, that are diagnosed; 0 for the diagnosis's own choice, or `SLOW`.
    """
    content: dict[str, Any] = {
        "simulator": MODEL if case.simulator == "learned" else "simulator.yaml",
        "recordings": ["recordings"],
    }
    if case.baseline:
        content["baseline"] = ["baseline"]
    if case.simulator == "reference":
        content["parameters"] = False
    if case.rate != RATES[-1]:
        content["rate"] = case.rate
    if case.scale != BUGGY:
        content["car"] = CAR
    if case.longitudinal != ONE_WAY:
        content["columns"] = COLUMNS
        effects = effects or offered(case.longitudinal)
    if effects:
        content["effects"] = effects
    if segments or case.simulator in SLOW:
        content["stretches"] = segments or SLOW[case.simulator]
    return yaml.safe_dump(content, sort_keys=False)
