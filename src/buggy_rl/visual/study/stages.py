"""The stages of a study: one script each, run once, in the order of what they need.

A stage's job folder is OUTPUT/stages/NAME; what its script writes lies where the script would put
it by hand. A stage whose outcome is there is not run again.
"""

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Literal

import yaml

from buggy_rl.core.config import plain_values
from buggy_rl.core.files import write_atomically
from buggy_rl.core.question import Question, question
from buggy_rl.estimation.fit_study import StudyConfig, fit_file, model_file, model_runs
from buggy_rl.jobs import Job
from buggy_rl.jobs.launching import Launching


@dataclass(frozen=True)
class PolicyStage:
    """Training of the policies; one each in the best learned model and in the fitted simulator."""

    configs: list[str] = field(default_factory=lambda: ["configs/ppo.yaml"])
    """Config files of scripts/train_policy.py, later ones over earlier ones."""
    options: list[str] = field(default_factory=list)
    """Further options of scripts/train_policy.py, such as ppo.steps=300000."""
    seeds: list[int] = field(default_factory=lambda: [0])
    """One policy is trained for each; empty for no policies."""
    course: str = "infinity"
    """Course that the film shows."""


@dataclass(frozen=True)
class WholeStudyConfig(StudyConfig, Launching):
    """Everything from a folder of recordings to study.html."""

    title: str = ""
    """Title of the page; empty for the name of the output folder."""
    policy: PolicyStage = field(default_factory=PolicyStage)
    diagnosed: Literal["fitted", "shipped"] = "fitted"
    """Which simulator is diagnosed: the fitted one on the held-out recordings, or the one as it
    comes, on the recordings that it is fitted to: then held-out ones judge its repair."""
    diagnosis: list[str] = field(default_factory=list)
    """Further options of scripts/diagnose.py, such as segments=60."""
    film_seconds: float = 6.0
    """Length of each film; 0 for none."""
    workers: int = 2
    """Stages that run at the same time, where neither needs the other."""

    @property
    def of_simulators(self) -> StudyConfig:
        """The part that trains, fits and compares simulators."""
        return StudyConfig(**{f.name: getattr(self, f.name) for f in fields(StudyConfig)})


FILE, REPAIR = "study.yaml", "repair.yaml"
MODELS = ("car", "data", "runs", "only")  # of the config: what a stage depends on
FIT = ("car", "data", "fit", "fit_simulator", "fit_options")
TABLE = (*MODELS, "fit_simulator", "fit_options", "simulators", "windows", "shown")
KINDS = "learned", "fitted"
"""Names of the two simulators that policies are trained in."""


@dataclass(frozen=True)
class Stage:
    """A job, and what it is for."""

    job: Job
    title: str
    """Title on the page."""


class StudyPlan:
    """All stages of a study.

    Args:
        config: The study.
        compared: Files of the recordings that the diagnosis compares.
        scripts: The folder of the project's scripts.
        recordings: What the stages read of recordings (`question.contents`).
    """

    def __init__(
        self,
        config: WholeStudyConfig,
        compared: Sequence[str],
        scripts: Path,
        recordings: Question | None = None,
    ) -> None:
        self.config, self.folder, self._scripts = config, Path(config.output), scripts
        self._compared, self._recordings = compared, recordings or {}
        self._study = config.of_simulators

    def write(self) -> None:
        """Writes the configs that scripts take: of the study, and of the table after the repair."""
        compared = {"fitted": str(self.fitted), "repaired": str(self.repaired)}
        repair = replace(
            self._study, output=str(self.folder / "repair"), runs={}, only=[], simulators=compared
        )
        for file, study in ((FILE, self._study), (REPAIR, repair)):
            content = yaml.safe_dump(plain_values(study), sort_keys=False)
            write_atomically(self.folder / file, content)

    def waves(self) -> Iterator[Sequence[Stage]]:
        """Groups of stages; those of a group need only what earlier groups have written.

        A generator, since the best learned model is known only when the table is there.
        """
        models, mujoco = self._models(), self._fit()
        yield [models, mujoco]
        yield [self._table()]
        yield [*self._policies(), self._diagnosis()]
        yield [self._repair(), *self._tables()]
        yield [self._figures(), *self._films()]

    @property
    def fitted(self) -> Path:
        """The simulator file that the fit writes."""
        return self.folder / fit_file(self._study)

    @property
    def simulators(self) -> dict[str, Path]:
        """The simulators that policies are trained in: the best learned model, the fitted one."""
        return dict(zip(KINDS, (self.best_model(), self.fitted), strict=True))

    @property
    def repaired(self) -> Path:
        """The repaired simulator that the diagnosis writes."""
        return self.folder / "diagnosis" / "repaired.yaml"

    def policies(self) -> dict[str, list[Path]]:
        """Kind -> the policies trained in that simulator, one a seed."""
        seeds = self.config.policy.seeds
        return {kind: [self._policy(kind, seed) / "best.pt" for seed in seeds] for kind in KINDS}

    def best_model(self) -> Path:
        """The trained model with the smallest 1 s error in the study's table.

        Raises:
            ValueError: The table has no learned model.
        """
        names = {name: model_file(self._study, name) for name, _, _ in model_runs(self._study)}
        with (self.folder / "table.csv").open() as lines:
            rows = [row for row in csv.DictReader(lines) if row["simulator"] in names]
        if not rows:
            raise ValueError(f"{self.folder}/table.csv has no learned model: name some under runs")
        best = min(rows, key=lambda row: float(row["position_mse_1s"]))
        return names[best["simulator"]]

    def _stage(
        self,
        name: str,
        title: str,
        script: str,
        arguments: Sequence[str],
        inputs: Sequence[Path] = (),
        checkpoint: str = "",
        parts: Sequence[str] = (),
    ) -> Stage:
        command = (str(self._scripts / script), *arguments)
        job = Job(
            name,
            self.folder / "stages" / name,
            command,
            inputs=tuple(str(file) for file in inputs),
            checkpoint=checkpoint,
            question=self._question(parts, arguments),
        )
        return Stage(job, title)

    def _question(self, parts: Sequence[str], arguments: Sequence[str]) -> Question:
        """What a stage depends on beside its command: settings by name, files of its arguments."""
        config = plain_values(self._study)
        own = question({name: config[name] for name in parts}) | (self._recordings if parts else {})
        written = str(self.folder)  # what another stage writes is among the inputs
        named = [a.partition("=")[2] or a for a in arguments if written not in a]
        return own | {n: v for n, v in question({"files": named}).items() if n != "files"}

    def _models(self) -> Stage:
        return self._stage(
            "models", "Learned models", "train_models.py", [self._file], parts=MODELS
        )

    def _fit(self) -> Stage:
        return self._stage("fit", "Fitted simulator", "fit_mujoco.py", [self._file], parts=FIT)

    def _table(self) -> Stage:
        models = [model_file(self._study, name) for name, _, _ in model_runs(self._study)]
        return self._stage(
            "table",
            "Open-loop errors",
            "evaluate_models.py",
            [self._file],
            [*models, self.fitted],
            parts=TABLE,
        )

    def _policy(self, kind: str, seed: int) -> Path:
        return self.folder / "policies" / f"{kind}_{seed}"

    def _policies(self) -> Iterator[Stage]:
        policy = self.config.policy
        for seed in policy.seeds:
            for kind, simulator in self.simulators.items():
                folder = self._policy(kind, seed)
                own = [f"engine.simulator={simulator}", f"seed={seed}", f"output={folder}"]
                yield self._stage(
                    f"policy_{kind}_{seed}",
                    f"Policy trained in the {kind} simulator, seed {seed}",
                    "train_policy.py",
                    [*policy.configs, *policy.options, *own],
                    [simulator],
                    str(folder.resolve() / "checkpoint.pt"),
                )

    def _tables(self) -> Iterator[Stage]:
        if not self.config.policy.seeds:
            return
        files = [file for files in self.policies().values() for file in files]
        named = [f"policies.{kind}=[{_listed(own)}]" for kind, own in self.policies().items()]
        named += [f"simulators.{kind}={file}" for kind, file in self.simulators.items()]
        arguments = [*named, f"output={self.folder / 'policies'}"]
        yield self._stage(
            "policies", "Policies on every engine", "evaluate_policies.py", arguments, files
        )

    def _diagnosis(self) -> Stage:
        config, fitted = self.config, self.config.diagnosed == "fitted"
        arguments = [
            f"simulator={self.fitted if fitted else config.fit_simulator}",
            f"recordings=[{','.join(self._compared)}]",
            *([f"columns={config.data.columns}"] if config.data.columns else []),
            *([f"car={config.car}"] if config.car else []),
            f"threads={config.workers}",  # nothing else takes as long: it ends alone
            *config.diagnosis,
            f"output={self.folder / 'diagnosis'}",
        ]
        return self._stage("diagnosis", "Diagnosis", "diagnose.py", arguments, [self.fitted])

    def _repair(self) -> Stage:
        file = str(self.folder / REPAIR)
        return self._stage(
            "repair",
            "Repaired simulator",
            "evaluate_models.py",
            [file],
            [self.repaired, self.fitted],
            parts=("car", "data", "windows"),
        )

    def _films(self) -> Iterator[Stage]:
        seconds = self.config.film_seconds
        if not seconds:
            return
        common = [f"seconds={seconds:g}", "size=[480,360]"]
        if self.config.policy.seeds:
            policy = self.policies()["fitted"][0]
            course = f"course={self.config.policy.course}"
            file = f"output={self.folder / 'films' / 'policy.mp4'}"
            arguments = [f"what={policy}", "ghost=pure_pursuit", course, file, *common]
            yield self._stage("film_policy", "Film of a policy", "render.py", arguments, [policy])

    def _figures(self) -> Stage:
        own = [f"folder={self.folder / 'figures'}"]
        if self.config.policy.seeds:
            for kind, files in self.policies().items():
                own += [f"learning.runs.{kind}=[{_listed([file.parent for file in files])}]"]
                own += [f"policies.policies.{kind}={files[0]}"]
        return self._stage("figures", "Figures", "figures.py", [self._file, *own])

    @property
    def _file(self) -> str:
        return str(self.folder / FILE)


def _listed(files: Sequence[Path]) -> str:
    return ",".join(map(str, files))
