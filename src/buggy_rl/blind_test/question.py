"""The simulator that a case gives to be repaired, as the file that the tool reads."""

import random
import shutil
from pathlib import Path
from typing import Any

import yaml

from buggy_rl.blind_test.case import Case
from buggy_rl.engines import make_engine, read_simulator
from buggy_rl.engines.base import Engine

PLAIN = ("reference", "mujoco")  # simulators as they are shipped; all others are prepared
COARSE = {"reference": {"substep": 0.005}, "mujoco": {"timestep": 0.005}}  # five times, twice
SLOW = {"mujoco": 60, "mujoco_fitted": 60}  # stretches that are looked at where time counts
MODEL = "simulator.pt"


def prepared_name(case: Case) -> str:
    """File, without its ending, that has to be prepared for a case; empty if none has."""
    return "" if case.simulator in PLAIN else f"{case.plant}_{case.simulator}"


def simulator_content(case: Case, prepared: Path) -> dict[str, Any]:
    """What the simulator file of a case says.

    Args:
        case: With the nuisance that may be in its simulator.
        prepared: Folder of simulators that had to be fitted or trained.
    """
    if case.simulator == "learned":
        return {"engine": MODEL}
    if case.simulator in PLAIN:
        content: dict[str, Any] = {"engine": case.simulator}
    else:
        file = read_simulator(prepared / f"{prepared_name(case)}.yaml")
        content = {key: value for key, value in file.items() if value}
    if content["engine"] == "reference" and shutil.which("g++"):
        content["options"] = {"compiled": True}  # the same motion, sooner
    if case.nuisance == "integrator":
        content["options"] = content.get("options", {}) | COARSE[content["engine"]]
    if case.nuisance.startswith("parameters"):
        share = float(case.nuisance.rpartition("_")[2]) / 100
        content["parameters"] = off(content, share, case.seed)
    return content


def off(content: dict[str, Any], share: float, seed: int) -> dict[str, float]:
    """All parameters of a simulator, each up or down by a share of itself, within its range."""
    chance = random.Random(f"parameters {seed}")
    engine = make_engine(content["engine"], 1)
    assert isinstance(engine, Engine)
    values = {}
    for name, parameter in engine.declared.items():
        value = content.get("parameters", {}).get(name, parameter.value)
        wrong = value * (1 + chance.choice((-1, 1)) * share)
        values[name] = round(min(max(wrong, parameter.lower), parameter.upper), 8)
    return values


def question(case: Case, effects: list[str], stretches: int = 0) -> str:
    """Options of `scripts/diagnose.py` as YAML: all that the tool is told.

    Args:
        case: Black boxes of its own make do not show their parameters.
        effects: To choose from; empty for the whole library.
        stretches: Of the drives, that the tool looks at; 0 for its own choice, or `SLOW`.
    """
    content: dict[str, Any] = {
        "simulator": MODEL if case.simulator == "learned" else "simulator.yaml",
        "recordings": ["recordings"],
    }
    if case.baseline:
        content["baseline"] = ["baseline"]
    if case.simulator == "reference":
        content["parameters"] = False
    if effects:
        content["effects"] = effects
    if stretches or case.simulator in SLOW:
        content["stretches"] = stretches or SLOW[case.simulator]
    return yaml.safe_dump(content, sort_keys=False)
