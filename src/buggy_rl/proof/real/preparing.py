"""Simulators that are fitted to, or trained on, an untouched half: once for half and engine."""

import shutil
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from buggy_rl.core.files import write_atomically
from buggy_rl.jobs import Job, run_jobs
from buggy_rl.jobs.launching import Launching
from buggy_rl.proof.cases.simulators import COLUMNS, MODEL
from buggy_rl.proof.real.dataset import Dataset, cut_pieces
from buggy_rl.recordings import Recording, save_recording
from buggy_rl.simulators import read_simulator

PIECE = 20.0  # [s] longest piece of a recording: two of them are kept from the fit
LEAST_PIECES = 8  # of which a fit has all but two
ENDINGS = {"learned": ".pt"}
CHECKED = {"agreement_distance": 10.0, "agreement_angle": 10.0}
"""Limits of what was checked once: velocities that a filter made of a noisy pose would be compared
with that pose as if they had a sensor of their own."""


def simulator_file(folder: Path, dataset: str, half: str, engine: str) -> Path:
    """File of a prepared simulator."""
    return folder / f"{dataset}_{half}_{engine}{ENDINGS.get(engine, '.yaml')}"


def preparing(
    dataset: Dataset,
    half: str,
    engine: str,
    folder: Path,
    scripts: Path,
    recordings: Sequence[Recording] = (),
) -> Job:
    """The job that makes a simulator; its drives are written where they are not there.

    A study divides whole recordings, and a half may have two: they are cut into pieces, of which
    the first decides when training stops and the last is left for its table.

    Args:
        dataset: Whose car it is.
        half: That it is fitted to, or a name of the recordings.
        engine: Simulator.
        folder: Of prepared simulators.
        scripts: Folder of `fit_mujoco.py` and `train_models.py`.
        recordings: What it is fitted to, where that is no half.
    """
    drives, name = folder / f"{dataset.name}_{half}_drives", f"{dataset.name}_{half}_{engine}"
    own = recordings or dataset.half(half)
    cut = list(cut_pieces(own, min(PIECE, sum(r.duration for r in own) / LEAST_PIECES)))
    save_recordings(cut, drives)
    options = [
        f"data.recordings=[{drives}]",
        f"data.validation=[{cut[0].name}]",
        f"data.held_out=[{cut[-1].name}]",
        f"output={folder / f'{name}_study'}",
        f"data.columns={drives / COLUMNS}",
        *dataset.config.fits.get(engine, []),
    ]
    if engine == "learned":
        command = (str(scripts / "train_models.py"), *options)
    else:
        car = f"car={dataset.config.car}"
        command = (str(scripts / "fit_mujoco.py"), f"fit_simulator={engine}", car, *options)
    return Job(name, folder / f"{name}_study", command)


def prepared(
    jobs: Mapping[Path, Job], workers: int, launching: Launching
) -> Iterator[tuple[int, str]]:
    """Runs jobs and puts what each made at its file; how many each time, and nothing to say.

    Args:
        jobs: File of the prepared simulator -> the job that makes it.
        workers: Jobs at a time.
        launching: Where.
    """
    files = {job.folder: file for file, job in jobs.items()}
    done = [job for job in jobs.values() if job.done]
    for job in done:  # of a run that was stopped before it was copied
        write_atomically(files[job.folder], _made(job).read_bytes())
        yield 1, ""
    for job, _, outcome in run_jobs(
        [j for j in jobs.values() if j not in done], workers, launching
    ):
        if outcome and outcome.status == "done":
            write_atomically(files[job.folder], _made(job).read_bytes())
            yield 1, ""


def _made(job: Job) -> Path:
    """File that the script of a job has written."""
    [found] = [*job.folder.glob("*_fitted.yaml"), *job.folder.glob("models/model.pt")]
    return found


def give_simulator(file: Path, folder: Path) -> str:
    """Puts a prepared simulator into the folder of a case; the name that it has there."""
    if file.suffix == ".pt":
        shutil.copyfile(file, folder / MODEL)
        return MODEL
    content: dict[str, Any] = {key: value for key, value in read_simulator(file).items() if value}
    write_atomically(folder / "simulator.yaml", yaml.safe_dump(content, sort_keys=False))
    return "simulator.yaml"


def save_recordings(recordings: Sequence[Recording], folder: Path, name: str = "") -> None:
    """Writes recordings, and the column map that reads them as they are.

    Args:
        recordings: Sensors beside the tracker are written too.
        folder: Where to.
        name: Begins the files' names, which are numbered then; else the recordings have theirs.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for number, recording in enumerate(recordings):
        file = folder / f"{f'{name}_{number:02d}' if name else recording.name}.csv"
        save_recording(recording, file)
    content = {"command": recordings[0].command.plain_fields, "limits": CHECKED}
    write_atomically(folder / COLUMNS, yaml.safe_dump(content, sort_keys=False))
