"""The simulator that a case gives to be repaired: shipped, fitted or learned, as files.

A simulator that is not shipped is fitted to, or trained on, drives of the unchanged car.
"""

import random
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml
from scipy.signal import lfilter
from tensordict import TensorDict
from torch import Tensor

from buggy_rl.core import keys
from buggy_rl.core.files import write_atomically
from buggy_rl.core.longitudinal import ONE_WAY
from buggy_rl.core.vehicle import CONTROL_PERIOD, Similarity
from buggy_rl.effects import offered
from buggy_rl.jobs import Job, run_jobs
from buggy_rl.proof.cases.case import BUGGY, RATES, Case, written
from buggy_rl.proof.cases.drives import drive_cases, measured_car, plant_parameters
from buggy_rl.recordings import Recording, save_recording
from buggy_rl.recordings.camera import DECIMALS, NOISES, Camera, CameraConfig
from buggy_rl.simulators import make_engine, read_simulator
from buggy_rl.simulators.base import Engine

BASELINE_NOISE = 100  # number of the first baseline drive, behind those of all other drives
RHO = 0.9  # correlation of coloured noise from row to row
JITTER = 1e-3  # [s] standard deviation of a stamp: a host computer that stamps on arrival
DROPPED = 0.002  # share of frames lost: one in five seconds, each of which cuts the drive


def save_drives(
    case: Case, true: TensorDict, folder: Path, numbers: Mapping[str, int], changed: bool = True
) -> None:
    """Records drives of a case, true motion [drives, T], and writes them as CSV files.

    `numbers` is file name, without its ending -> `place` of `recorded_case_drive`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for motion, (name, number) in zip(true, numbers.items(), strict=True):
        save_recording(recorded_case_drive(case, motion, changed, number), folder / f"{name}.csv")


def recorded_case_drive(case: Case, true: TensorDict, changed: bool, place: int) -> Recording:
    """One drive of a case as it is recorded.

    Args:
        case: Says what is wrong with the camera, and the nuisance.
        true: [T] motion.
        changed: Whether what is concealed is there yet; if not, the camera is right.
        place: Number of the drive, which decides its noise.
    """
    seed = case.seed * 1_000 + place
    config = similar_camera(CameraConfig(**(case.camera if changed else {})), case.car.similarity)
    for disturbance in case.disturbances if changed else ():
        true = disturbance.seen(true)
    if case.nuisance == "stamps":
        early = random.Random(f"stamps {case.key}").random() < 0.5
        true = stamped_off(true, early, case.every)
    if case.nuisance == "thrice":
        config = replace(config, **{name: 3 * getattr(config, name) for name in NOISES})
    if case.nuisance == "dropped":
        config = replace(config, dropped_share=DROPPED)
    if case.nuisance == "coloured":
        data = coloured(config, true, seed)
    else:
        data = Camera(config, seed).recorded(true)
    data = _thinned(data, case.every)
    if case.nuisance == "jitter":
        data[keys.TIME] = jittered(data[keys.TIME], seed)
    dt = case.every * CONTROL_PERIOD
    return Recording(f"drive_{place}", data, dt, command=case.longitudinal)


def similar_camera(config: CameraConfig, scale: Similarity) -> CameraConfig:
    """The camera of a similar car: its noise is as large a part of the motion as the buggy's."""
    units = zip(NOISES, ("m", "rad", "m/s", "rad/s"), strict=True)
    return replace(config, **{n: scale.of(unit) * getattr(config, n) for n, unit in units})


def stamped_off(true: TensorDict, early: bool, rows: int = 1) -> TensorDict:
    """The motion with its commands logged so many rows early, or late; the end's is held."""
    action = true[keys.ACTION]
    held = (action[-1:] if early else action[:1]).expand(rows, -1)
    moved = torch.cat([action[rows:], held] if early else [held, action[:-rows]])
    return true.clone().set(keys.ACTION, moved)


def _thinned(data: TensorDict, every: int) -> TensorDict:
    """Frames of a recording at 100 Hz, those of every so many control periods."""
    if every == 1:
        return data
    row = (data[keys.TIME][:, 0] / CONTROL_PERIOD).round().long()
    kept = row % every == 0
    gaps = row[kept].diff(prepend=row[:1]) > every
    columns: dict = {key: value[kept] for key, value in data.items()}
    return TensorDict(columns | {keys.SEGMENT: gaps.cumsum(0)}, int(kept.sum()))


def coloured(config: CameraConfig, true: TensorDict, seed: int) -> TensorDict:
    """Recorded with noise e_k = rho e_(k-1) + sqrt(1 - rho^2) w_k of the camera's own size."""
    quiet = replace(config, **dict.fromkeys(NOISES, 0.0))
    data = Camera(quiet, seed).recorded(true)
    position, yaw, speed, yaw_rate = (getattr(config, name) for name in NOISES)
    noise = correlated(len(data), 6, seed)
    for key, rows, size in (
        (keys.POSE, slice(0, 3), (position, position, yaw)),
        (keys.VELOCITY, slice(3, 6), (speed, speed, yaw_rate)),
    ):
        shown = data[key] + noise[:, rows] * torch.tensor(size)
        data[key] = torch.round(shown, decimals=DECIMALS)
    return data


def correlated(rows: int, columns: int, seed: int) -> Tensor:
    """Noise [rows, columns] of unit variance with correlation `RHO` from row to row."""
    generator = torch.Generator().manual_seed(seed)
    white = torch.randn(rows, columns, generator=generator, dtype=torch.float64).numpy()
    white[1:] *= np.sqrt(1 - RHO**2)  # the first row has the variance that all shall have
    return torch.as_tensor(lfilter([1.0], [1.0, -RHO], white, axis=0)).float()


def jittered(time: Tensor, seed: int) -> Tensor:
    """Stamps [T, 1] that are off by `JITTER`, in order still."""
    generator = torch.Generator().manual_seed(seed)
    off = JITTER * torch.randn(time.shape, generator=generator, dtype=time.dtype)
    return (time + off.clamp(-4 * JITTER, 4 * JITTER)).round(decimals=DECIMALS)


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
    own = f"_{case.id}" if case.own_car else ""  # fitted anew to this very plant
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
        content["parameters"] = off(content, share, case.key)
    return content


def off(content: dict[str, Any], share: float, seed: int | str) -> dict[str, float]:
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
    drives = folder / (f"{prepared_name(case)}_drives" if case.own_car else f"{case.plant}_drives")
    if not (drives / f"drive_{DRIVES - 1}.csv").exists():
        seed = case.seed if case.own_car else SEED
        car = Case(
            seed,
            case.plant,
            case.plant,
            seconds=SECONDS,
            drives=DRIVES,
            held_out=0,
            spread=case.spread,
            salt=case.salt,
        )
        # Noise behind that of all other drives of the case.
        numbers = {f"drive_{n}": n + (PREPARING if case.own_car else 0) for n in range(DRIVES)}
        save_drives(car, drive_cases([car])[0].changed, drives, numbers, changed=False)
    study = folder / f"{prepared_name(case)}_study"
    options = (f"data.recordings=[{drives}]", f"output={study}", *_car_option(case, folder))
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


def _car_option(case: Case, folder: Path) -> list[str]:
    """Writes the file of a car that is not the buggy, and names it."""
    measured = measured_car(case)
    if measured is None:
        return []
    file = folder / f"{prepared_name(case)}_{CAR}"
    file.write_text(yaml.safe_dump(written(measured), sort_keys=False))
    return [f"car={file}"]


def _file(folder: Path, case: Case) -> Path:
    return folder / (prepared_name(case) + (".pt" if case.simulator == "learned" else ".yaml"))


def diagnosis_options(case: Case, effects: list[str], segments: int = 0) -> str:
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
    if measured_car(case) is not None:
        content["car"] = CAR
    if case.longitudinal != ONE_WAY:
        content["columns"] = COLUMNS
        effects = effects or offered(case.longitudinal)
    if effects:
        content["effects"] = effects
    if segments or case.simulator in SLOW:
        content["stretches"] = segments or SLOW[case.simulator]
    return yaml.safe_dump(content, sort_keys=False)
