"""Simulators that are fitted to, or trained on, drives of the right car before anything changed."""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from buggy_rl.blind_test.case import Case
from buggy_rl.blind_test.measuring import measured
from buggy_rl.blind_test.motion import moved
from buggy_rl.blind_test.question import prepared_name
from buggy_rl.recordings import save_recording

DRIVES, SECONDS = 6, 40.0  # as many and as long as the sample drives
SEED = 900_000_000  # of the drives that simulators are made from: no case has it
LEARNED = (  # the history MLP of configs/demo.yaml, trained on rollouts
    "runs.model.model.kind=mlp",
    "runs.model.model.options.rows=20",
    "runs.model.model.options.hidden=[128,128]",
    "runs.model.training.weight_decay=1e-3",
)


def needed(cases: Sequence[Case], folder: Path) -> list[Case]:
    """One case for each simulator that is still to be prepared."""
    found = {prepared_name(case): case for case in cases if prepared_name(case)}
    return [case for name, case in found.items() if not _file(folder, case).exists()]


def prepare(case: Case, folder: Path, scripts: Path) -> Path:
    """Drives the right car of a case's plant and makes the simulator from that.

    Args:
        case: Plant and simulator.
        folder: For the drives, the study and the simulator.
        scripts: Where `fit_mujoco.py` and `train_models.py` are.

    Raises:
        RuntimeError: The script failed; the message holds its last words.
    """
    drives = folder / f"{case.plant}_drives"
    if not (drives / f"drive_{DRIVES - 1}.csv").exists():
        drives.mkdir(parents=True, exist_ok=True)
        car = Case(SEED, case.plant, case.plant, seconds=SECONDS, drives=DRIVES, held_out=0)
        true = moved([car])[0].changed
        for place in range(DRIVES):
            drive = measured(car, true[place], False, place)
            save_recording(drive, drives / f"{drive.name}.csv")
    study = folder / f"{prepared_name(case)}_study"
    options = [f"data.recordings=[{drives}]", f"output={study}"]
    if case.simulator == "learned":
        _run(scripts / "train_models.py", *options, *LEARNED)
        made = study / "models" / "model.pt"
    else:
        engine = case.simulator.removesuffix("_fitted")
        _run(scripts / "fit_mujoco.py", *options, f"fit_simulator={engine}")
        made = study / f"{engine}_fitted.yaml"
    _file(folder, case).write_bytes(made.read_bytes())
    return _file(folder, case)


def _file(folder: Path, case: Case) -> Path:
    return folder / (prepared_name(case) + (".pt" if case.simulator == "learned" else ".yaml"))


def _run(script: Path, *options: str) -> None:
    done = subprocess.run(
        [sys.executable, str(script), *options], capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise RuntimeError(f"{script.name} {' '.join(options)} failed: {done.stderr[-1500:]}")
