"""Log of a run: metrics, pictures and films under the same names wherever they go."""

import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from uuid import uuid4

import yaml
from torchrl.record.loggers import CSVLogger, TensorboardLogger

from buggy_rl.files import write_atomically

PROJECT = "buggy_rl"
Row = tuple[Mapping[str, float], Mapping[str, Path]]


class RunLog:
    """Writes to CSV and TensorBoard, on request to Weights & Biases too.

    CSV has the metrics alone, as FOLDER/csv/scalars/NAME.csv; pictures (.png) and films (.gif) are
    files already. Rows are kept until `write`, so that a run which writes just before each
    checkpoint repeats none when it is resumed.

    Args:
        folder: Of the run.
        step: The metric that counts, such as `steps`.
        about: The run's config and whatever else says how it was made.
        wandb: Whether Weights & Biases is told, offline unless WANDB_MODE says otherwise.
        resume: Continues the log that this folder holds, instead of replacing it.
    """

    def __init__(
        self,
        folder: Path,
        step: str,
        about: Mapping[str, Any],
        wandb: bool = False,
        resume: bool = False,
    ) -> None:
        self._step = step
        self._rows: list[Row] = []
        for old in () if resume else ("csv", "tensorboard"):
            shutil.rmtree(folder / old, ignore_errors=True)
        self._csv = CSVLogger("csv", str(folder))
        self._board = TensorboardLogger("tensorboard", str(folder))
        self._board.experiment.add_text("config", f"```yaml\n{yaml.safe_dump(dict(about))}```")
        self._wandb = _wandb_logger(folder, about, resume) if wandb else None

    def add(self, metrics: Mapping[str, float], media: Mapping[str, Path] | None = None) -> None:
        """Keeps a row, and pictures and films by their names, for the next `write`."""
        self._rows.append((dict(metrics), dict(media or {})))

    def write(self) -> None:
        """Writes the rows out and forgets them."""
        for metrics, media in self._rows:
            step = int(metrics[self._step])
            for logger in (self._csv, self._board):
                logger.log_metrics(dict(metrics), step=step)
            for name, file in media.items():
                self._board.experiment.file_writer.add_summary(_summary(name, file), step)
            if self._wandb is not None:
                shown = {name: _wandb_media(file) for name, file in media.items()}
                self._wandb.log_metrics({**metrics, **shown}, step=step)
        self._rows.clear()
        self._board.experiment.flush()

    def close(self) -> None:
        """Ends the run at Weights & Biases and closes the files; rows not written are dropped."""
        self._board.experiment.close()
        if self._wandb is not None:
            self._wandb.experiment.finish()


def _wandb_logger(folder: Path, about: Mapping[str, Any], resume: bool):
    from torchrl.record.loggers.wandb import WandbLogger

    file = folder / "wandb_id.txt"  # a resumed run goes on in the same one there
    if not (resume and file.is_file()):
        write_atomically(file, uuid4().hex)
    mode = os.environ.get("WANDB_MODE", "offline")
    return WandbLogger(
        folder.name,
        save_dir=str(folder),
        id=file.read_text(),
        project=PROJECT,
        mode=mode,
        config=dict(about),
        log_env_packages=False,
    )


def _wandb_media(file: Path):
    import wandb

    if file.suffix == ".gif":
        return wandb.Video(str(file), format="gif")
    return wandb.Image(str(file))


def _summary(name: str, file: Path):
    """TensorBoard's summary of an encoded picture; a .gif moves there."""
    from PIL import Image
    from tensorboard.compat.proto.summary_pb2 import Summary  # type: ignore[attr-defined]  # generated

    with Image.open(file) as image:
        width, height = image.size
    encoded = Summary.Image(
        height=height, width=width, colorspace=3, encoded_image_string=file.read_bytes()
    )
    return Summary(value=[Summary.Value(tag=name, image=encoded)])
