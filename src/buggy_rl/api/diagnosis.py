"""The diagnosis as one object: its answer, its files, and the repaired simulator."""

import html
import json
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pandas as pd
import torch
import yaml
from torchrl.envs import EnvBase

from buggy_rl.api.drives import Drives, drives_of, names_of
from buggy_rl.core.config import from_python, save_run
from buggy_rl.core.files import rounded, write_atomically
from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.diagnosis import pipeline
from buggy_rl.diagnosis.answer.answer import Verdict
from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.diagnosis.repaired import learned_of, repaired_simulator
from buggy_rl.diagnosis.report import report, sheet_of
from buggy_rl.diagnosis.report.page import _drawn
from buggy_rl.diagnosis.run.meter import StepBar
from buggy_rl.diagnosis.run.stages import FOLDER as STAGES
from buggy_rl.diagnosis.run.stages import begun_otherwise, clear, diagnosis_question
from buggy_rl.effects import make_effects
from buggy_rl.estimation.baseline import FILE
from buggy_rl.simulators import Factory, simulator_name
from buggy_rl.task.env import make_simulator, with_effects

ANSWER, REPAIRED, REPORT = "diagnosis.json", "repaired.yaml", "report.html"
DIGITS = 9  # of numbers in a file: those of two numbers of workers differ in the 15th
IN_PYTHON = "buggy_rl.diagnose(...)"


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What a simulator and recordings say about each other.

    In a notebook it shows its sentences, its effects and a replayed segment.
    """

    config: DiagnosisConfig
    """The question."""
    done: pipeline.Diagnosed
    """The answer with what it came from: segments, noise, all hypotheses that were fitted."""
    command: str = ""
    """Command line that asked it; empty for that of this process."""

    @property
    def verdict(self) -> Verdict:
        """missing_physics, wrong_parameters, unknown_physics, no_mismatch or cannot_tell."""
        return self.done.answer.verdict

    @property
    def lines(self) -> list[str]:
        """The answer in a few sentences."""
        return self.done.answer.lines()

    @property
    def notes(self) -> list[str]:
        """What to know about recordings, simulator and search."""
        return self.done.answer.notes

    @cached_property
    def effects(self) -> pd.DataFrame:
        """A row for each number of each named effect, with the bounds of its 95 % interval.

        Columns: effect, kind, parameter, value, low, high, unit, confidence, held_out_gain.
        """
        columns = ["effect", "kind", "parameter", "value", "low", "high", "unit"]
        rows = [
            {"effect": effect["name"], "kind": effect["kind"], "parameter": name, **numbers}
            | {key: effect[key] for key in ("confidence", "held_out_gain")}
            for effect in self.to_dict()["effects"]
            for name, numbers in effect["parameters"].items()
        ]
        return pd.DataFrame(rows, columns=[*columns, "confidence", "held_out_gain"])

    @property
    def fit(self) -> dict[str, Any]:
        """Errors on what was held out, before and after the repair: `fit` of diagnosis.json."""
        return self.to_dict()["fit"]

    def to_dict(self) -> dict[str, Any]:
        """The content of diagnosis.json."""
        return self.done.answer.to_dict()

    def repaired(self, batch_size: int | Sequence[int] = (), device: str = "cpu") -> EnvBase:
        """The simulator with the repair that was validated.

        Args:
            batch_size: Number of environments or a shape.
            device: Where the state lives.
        """
        with TemporaryDirectory() as folder:
            self._save_network(Path(folder))
            content = self._repaired(Path(folder))
            made, effects = content.get("parameters"), content.get("effects", {})
            simulator, options = self.config.simulator, content.get("options", {})
            engine = make_simulator(simulator, batch_size, device, made, **options)
            dt = getattr(engine, "dt", CONTROL_PERIOD)
            own = {} if dt == CONTROL_PERIOD else {"dt": dt}
            beside = {
                name: {**own, **values, **_beside(Path(folder), values)}
                for name, values in effects.items()
            }
            return with_effects(engine, make_effects(beside))

    def report(self, file: str | Path) -> Path:
        """Writes the report as one HTML file that needs no other.

        Args:
            file: To be written.
        """
        write_atomically(Path(file), self._page(self._repaired(Path(file).parent)))
        return Path(file)

    def save(self, folder: str | Path) -> list[Path]:
        """Writes diagnosis.json, repaired.yaml, which is a simulator, and report.html.

        Args:
            folder: Made if it is not there; nothing is written before all is computed.

        Raises:
            ValueError: The simulator is an object, which no file can name.
        """
        folder, name = Path(folder), simulator_name(self.config.simulator)
        if callable(self.config.simulator):
            raise ValueError(
                f"{name} is an object, which {REPAIRED} cannot "
                "name: give the simulator as file.py:factory, or use report() and repaired()"
            )
        content = self._repaired(folder)
        page = self._page(content)
        folder.mkdir(parents=True, exist_ok=True)
        answer = rounded(self.to_dict(), DIGITS)
        write_atomically(folder / ANSWER, json.dumps(answer, indent=2) + "\n")
        self._save_network(folder)
        write_atomically(folder / REPAIRED, yaml.safe_dump(content, sort_keys=False))
        write_atomically(folder / REPORT, page)
        return [folder / name for name in (REPORT, ANSWER, REPAIRED)]

    def __str__(self) -> str:
        return "\n".join(self.lines)

    def _repr_html_(self) -> str:
        """Shows sentences, effects, and the segment that the repair changes most, in a notebook."""
        said = "".join(f"<p>{html.escape(line)}</p>" for line in self.lines)
        caption, picture = _drawn(self.done.case, self.done.found, self.done.answer.repair)[0]
        table = self.effects.to_html(index=False) if len(self.effects) else ""
        legend = f"<figcaption>{html.escape(caption)}</figcaption>"
        return f"{said}{table}<figure>{picture}{legend}</figure>"

    def _repaired(self, folder: Path) -> dict[str, Any]:
        """Content of repaired.yaml, with paths from a folder."""
        return repaired_simulator(simulator_name(self.config.simulator), self.done, folder)

    def _page(self, content: Mapping[str, Any]) -> str:
        sheet = sheet_of(self.config, content)
        if self.command:
            sheet = replace(sheet, facts={**sheet.facts, "Command": self.command})
        return report(self.done.case, self.done.found, self.done.answer, sheet)

    def _save_network(self, folder: Path) -> None:
        """Writes the network of the repaired simulator, where there is one."""
        if learned := learned_of(self.done):
            learned.network.save(folder / FILE)


def diagnose(
    recordings: Drives,
    simulator: str | Path | Factory,
    baseline: Drives = (),
    *,
    files: Sequence[str | Path] = (),
    output: str | Path = "",
    **settings: Any,
) -> Diagnosis:
    """Says where a simulator and recordings differ and what physics is missing; repairs it.

    Args:
        recordings: What the simulator should have predicted: recordings, or their paths.
        simulator: An engine's name, a .yaml, a .pt, file.py:factory, or a factory itself.
        baseline: Recordings on which it was right; then what is found is what has changed since.
        files: YAML files of settings.
        output: Folder for the files of `Diagnosis.save`, and for stages, from which an interrupted
            diagnosis goes on; empty writes nothing.
        settings: Fields of `DiagnosisConfig`: car, columns, effects, seconds, stretches, minutes,
            workers, and so on.

    Raises:
        ValueError: A setting is unknown, the recordings cannot be used, or the simulator breaks its
            contract; the message says which and what to do.
    """
    given = {"recordings": names_of(recordings), "baseline": names_of(baseline)}
    given |= {"simulator": simulator_name(simulator), "output": str(output)}
    config = from_python(DiagnosisConfig, {**settings, **given}, "diagnose", files)
    config = replace(config, simulator=simulator if callable(simulator) else str(simulator))
    folder = Path(output) if output else None
    return diagnosed(config, recordings, baseline, warnings.warn, folder, IN_PYTHON)


def diagnosed(
    config: DiagnosisConfig,
    recordings: Drives,
    baseline: Drives,
    says: Callable[[str], object],
    folder: Path | None,
    command: str = "",
) -> Diagnosis:
    """The answer to a question that is asked in Python or on the command line.

    Args:
        config: The question.
        recordings: What the simulator should have predicted.
        baseline: Recordings on which it was right; empty for none.
        says: Told of recordings that are refused or doubtful.
        folder: Of the answer's files and, until they are written, of stages; None writes nothing.
        command: That asks; empty for that of this process.
    """
    read = (config.columns or None, config.dt, config.car)
    drives = drives_of(recordings, says, *read)
    before = drives_of(baseline, says, *read, what="baseline drive") if baseline else []
    kept = folder / STAGES if folder else None
    if kept and (why := begun_otherwise(kept, diagnosis_question(config, drives, before))):
        says(f"note: begun anew, not gone on with what is in {kept}: {why}")
    with StepBar() as bar, _one_thread():
        done = pipeline.run_diagnosis(config, drives, bar.says, before, kept, bar.show)
        found = Diagnosis(config, done, command)
        if folder and kept:
            bar.says("drawing the report")
            found.save(folder)
            save_run(config, folder)
            clear(kept)  # the answer is written: nothing is left to go on with
    return found


@contextmanager
def _one_thread() -> Iterator[None]:
    """PyTorch on one thread: on more, steps as small as these take longer."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def _beside(folder: Path, values: Mapping[str, Any]) -> dict[str, str]:
    """An effect's network, which lies in a folder."""
    return {"model": str(folder / values["model"])} if "model" in values else {}
