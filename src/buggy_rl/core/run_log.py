"""Log of a run: metrics, pictures and films under the same names wherever they go."""

import json
import os
import warnings
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any
from uuid import uuid4

import yaml
from torchrl.record.loggers import CSVLogger, TensorboardLogger

from buggy_rl.core.extras import MissingExtraError, needs
from buggy_rl.core.files import write_atomically, write_json

PROJECT = "buggy_rl"
WRITTEN = "log_files.json"  # names of the files of a log, so that no other is touched
Row = tuple[Mapping[str, float], Mapping[str, Path]]


class RunLog:
    """Writes to CSV, to TensorBoard where it is installed, and on request to Weights & Biases.

    CSV has the metrics alone, as FOLDER/csv/scalars/NAME.csv; pictures (.png) and films (.gif) are
    files already. Rows are kept until `write`, just before each checkpoint. Until the first one the
    log that the folder holds is as it was; then it is replaced, or cut behind the row that the run
    goes on from, so that no row stands there twice.

    Args:
        folder: Of the run.
        step: The metric that counts, such as `steps`.
        about: The run's config and whatever else says how it was made.
        wandb: Whether Weights & Biases is told, offline unless WANDB_MODE says otherwise.
        resumed_at: The value of `step` from which the run goes on; None begins a log.

    Raises:
        ValueError: The folder of the metrics holds a file of somebody else's.
    """

    def __init__(
        self,
        folder: Path,
        step: str,
        about: Mapping[str, Any],
        wandb: bool = False,
        resumed_at: int | None = None,
    ) -> None:
        self._folder, self._step, self._about = folder, step, about
        self._rows: list[Row] = []
        self._resumed_at = resumed_at
        self._files = _Files(folder)
        self._files.refuse_others()
        self._csv: CSVLogger | None = None
        self._board: TensorboardLogger | None = None
        self._wandb = _wandb_logger(folder, about, resumed_at is not None) if wandb else None

    def add(self, metrics: Mapping[str, float], media: Mapping[str, Path] | None = None) -> None:
        """Keeps a row, and pictures and films by their names, for the next `write`."""
        self._rows.append((dict(metrics), dict(media or {})))

    def write(self) -> None:
        """Writes the rows out and forgets them."""
        if self._csv is None:
            self._open()
        assert self._csv is not None
        for metrics, media in self._rows:
            step = int(metrics[self._step])
            if set(metrics) > {self._step}:
                self._files.add_metrics(metrics)
                for logger in filter(None, (self._csv, self._board)):
                    logger.log_metrics(dict(metrics), step=step)
            if self._board is not None:
                for name, file in media.items():
                    self._board.experiment.file_writer.add_summary(_summary(name, file), step)
            if self._wandb is not None:
                shown = {name: _wandb_media(file) for name, file in media.items()}
                self._wandb.log_metrics({**metrics, **shown}, step=step)
        self._rows.clear()
        if self._board is not None:
            self._board.experiment.flush()

    def close(self) -> None:
        """Ends the run at Weights & Biases and closes the files; rows not written are dropped."""
        if self._board is not None:
            self._board.experiment.close()
        if self._wandb is not None:
            self._wandb.experiment.finish()

    def _open(self) -> None:
        if self._resumed_at is None:
            self._files.remove()
        else:
            self._files.cut(self._resumed_at)
        self._csv = CSVLogger("csv", str(self._folder))
        try:
            needs("tensorboard", "visual", "a log for TensorBoard")
        except MissingExtraError as error:
            warnings.warn(f"{error}; the log is CSV alone")
            return
        self._board = TensorboardLogger("tensorboard", str(self._folder))
        self._files.add_events(Path(self._board.experiment.file_writer.event_writer._file_name))
        _hide_later(self._board, 0 if self._resumed_at is None else self._resumed_at + 1)
        about = yaml.safe_dump(dict(self._about))
        self._board.experiment.add_text("config", f"```yaml\n{about}```")


class _Files:
    """The files of the log in a folder, by a list of them that lies beside."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._list = folder, folder / WRITTEN
        self._names: list[str] = json.loads(self._list.read_text()) if self._list.exists() else []

    def refuse_others(self) -> None:
        """Refuses files among the metrics that no log wrote: they would be taken for metrics."""
        own = {self._folder / name for name in self._names}
        others = sorted(set((self._folder / "csv" / "scalars").glob("*.csv")) - own)
        if others:
            raise ValueError(
                f"{others[0]} is no file of a log that is known here ({WRITTEN} does not name it): "
                "move it elsewhere, or use another output"
            )

    def add_metrics(self, metrics: Collection[str]) -> None:
        """Lists the files of metrics, before they are written."""
        self._add([f"csv/scalars/{name}.csv" for name in metrics])

    def add_events(self, file: Path) -> None:
        """Lists a file of TensorBoard's."""
        self._add([file.relative_to(self._folder).as_posix()])

    def remove(self) -> None:
        """Takes the files of the log away."""
        for name in self._names:
            (self._folder / name).unlink(missing_ok=True)
        self._names = []

    def cut(self, last: int) -> None:
        """Takes away rows behind a step, of a run that was stopped after it had written them."""
        for name in self._names:
            file = self._folder / name
            if file.suffix == ".csv" and file.exists():
                rows = file.read_text().splitlines(keepends=True)
                write_atomically(file, "".join(row for row in rows if _is_up_to(row, last)))

    def _add(self, names: Collection[str]) -> None:
        if new := [name for name in names if name not in self._names]:
            self._names += new
            write_json(self._list, self._names)


def _is_up_to(row: str, last: int) -> bool:
    """Whether a row STEP,VALUE is whole, and of a step up to the last one."""
    step, comma, _ = row.partition(",")
    return bool(comma) and row.endswith("\n") and int(float(step)) <= last


def _hide_later(board: TensorboardLogger, step: int) -> None:
    """Has TensorBoard hide what earlier files of the folder hold of this step and later ones."""
    from tensorboard.compat.proto.event_pb2 import Event, SessionLog  # type: ignore[attr-defined]  # generated

    begin = SessionLog(status=SessionLog.START)
    for event in (Event(file_version="brain.Event:2"), Event(session_log=begin)):
        board.experiment.file_writer.add_event(event, step)


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
