"""A search for the settings of PPO: Optuna proposes, independent jobs train.

Trials run in rounds of `together`: proposals and pruning of a round depend on the rounds before it
alone, and are told in the order of their numbers. So the search does not depend on the launcher,
the number of workers, or on where it was stopped.

OUTPUT/study.log          Optuna's journal
OUTPUT/trials/NUMBER/     one training a trial
OUTPUT/confirmed/NAME/    the best settings, and `default`, with further seeds
"""

import hashlib
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from omegaconf import MISSING

from buggy_rl.jobs import Job, Running, read_outcome
from buggy_rl.jobs.launching import Launching, required
from buggy_rl.jobs.process import LOST
from buggy_rl.policies.training.seeds import CHECKPOINT, share_trained, validations


@dataclass(frozen=True)
class OptionRange:
    """Values of one option."""

    low: float = 0.0
    """Smallest value."""
    high: float = 0.0
    """Largest value."""
    log: bool = False
    """Whether its logarithm is uniform."""
    integer: bool = False
    """Whether only whole numbers are taken."""
    choices: list[Any] = field(default_factory=list)
    """Values to choose from, in place of a range."""

    def suggested(self, trial: Any, name: str) -> Any:
        """A value for an Optuna trial.

        Raises:
            ValueError: The range is empty.
        """
        if self.choices:
            return trial.suggest_categorical(name, list(self.choices))
        if not self.low < self.high or (self.log and self.low <= 0):
            raise ValueError(
                f"space.{name}: low={self.low:g}, high={self.high:g}: low must be below high, and "
                "above 0 where log is true; or give choices"
            )
        if self.integer:
            return trial.suggest_int(name, round(self.low), round(self.high), log=self.log)
        return trial.suggest_float(name, self.low, self.high, log=self.log)


@dataclass(frozen=True)
class SweepConfig(Launching):
    """Which settings are searched, and how long."""

    output: str = MISSING
    """Folder of the journal, the trials and the report."""
    policy: list[str] = field(default_factory=lambda: ["configs/ppo.yaml"])
    """YAML files and options of scripts/train_policy.py, the same for every trial."""
    space: dict[str, OptionRange] = field(default_factory=dict)
    """Options that are searched, as "ppo.learning_rate": {low: 1e-4, high: 1e-2, log: true}."""
    steps: int = 1_000_000
    """PPO steps of a trial."""
    validations: int = 6
    """Validations of each trial; after each it may be pruned."""
    trials: int = 48
    """Trials in all."""
    together: int = 8
    """Trials of a round; more than `workers` waste nothing but proposals."""
    startup: int = 8
    """Complete trials before one is pruned."""
    best: int = 3
    """Settings that are trained again with further seeds."""
    seeds: list[int] = field(default_factory=lambda: [1, 2, 3, 4, 5])
    """Seeds of those trainings."""
    confirm_steps: int = 0
    """PPO steps of each of them; 0: as many as a trial. What learns fastest in a short trial need
    not be the best of a whole training."""
    seed: int = 0
    """Seed of the search, and of every trial's training."""
    workers: int = 2
    """Trainings at a time."""

    def __post_init__(self) -> None:
        if not self.space:
            raise ValueError("space is empty: name options to search, as in configs/sweep.yaml")
        if self.seed in self.seeds:
            raise ValueError(
                f"seed={self.seed} is among seeds={self.seeds}: what the search chose must be "
                "confirmed with other seeds"
            )

    @property
    def folder(self) -> Path:
        """Folder of the sweep."""
        return Path(self.output)

    @property
    def question(self) -> str:
        """Digest of all that a trial depends on."""
        spaces = {name: vars(values) for name, values in self.space.items()}
        asked = [self.policy, spaces, self.steps, self.validations, self.together, self.startup]
        return hashlib.sha256(json.dumps([*asked, self.seed]).encode()).hexdigest()


VALIDATED = Path("csv") / "scalars" / "selection_waypoints.csv"  # steps, value
DEFAULT = "default"
POLL = 0.5  # [s] between two looks at the trials; a validation comes every 10 s or more


class Ended(NamedTuple):
    """A trial that is over."""

    number: int
    values: Mapping[str, Any]
    """Settings of the trial."""
    curve: list[float]
    """Waypoints on the selection paths, validation after validation."""
    state: str
    """complete, pruned or failed."""


class Sweep:
    """A study in a file; what is in it is not done again.

    Args:
        config: What is searched.
        script: `train_policy.py`.

    Raises:
        ValueError: Optuna is missing, or the journal holds a sweep of other settings.
    """

    def __init__(self, config: SweepConfig, script: Path) -> None:
        self.config, self._script = config, script
        optuna = self._optuna = required("optuna", "a sweep")
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        config.folder.mkdir(parents=True, exist_ok=True)
        file = config.folder / "study.log"
        backend = optuna.storages.journal.JournalFileBackend(str(file))
        self.study = optuna.create_study(
            storage=optuna.storages.JournalStorage(backend),
            study_name="sweep",
            direction="maximize",
            load_if_exists=True,
        )
        self._pruner = optuna.pruners.MedianPruner(n_startup_trials=config.startup)
        if self.study.user_attrs.get("question", config.question) != config.question:
            raise ValueError(f"{file} was begun with other settings: use another output")
        self.study.set_user_attr("question", config.question)

    def run(self) -> Iterator[Ended]:
        """Runs the trials that are missing, round by round.

        Yields:
            Each trial when its round is over.

        Raises:
            ValueError: A trial was lost too often, or all of a round have failed.
        """
        done = len(self.ended())
        while done < self.config.trials:
            trials = self._asked(done)
            ended = self._round(trials)
            if all(trial.state == "failed" for trial in ended):
                job = self._job(ended[0].number, ended[0].values)
                raise ValueError(f"every trial of the round failed; see {job.folder / 'log.txt'}")
            done += len(ended)
            yield from ended

    def ended(self) -> list[Ended]:
        """Trials that are over, by number."""
        found = [trial for trial in self.study.trials if trial.state.is_finished()]
        return [
            Ended(t.number, t.params, list(t.intermediate_values.values()), _name(t)) for t in found
        ]

    def confirmations(self) -> dict[str, list[Job]]:
        """Trainings with further seeds: of the best settings, and of what the config has."""
        complete = [trial for trial in self.ended() if trial.state == "complete"]
        best = sorted(complete, key=lambda trial: -max(trial.curve))[: self.config.best]
        settings = {DEFAULT: {}, **{f"trial_{t.number:04d}": t.values for t in best}}
        steps = self.config.confirm_steps or self.config.steps
        place = self.config.folder / f"confirmed_{steps}"
        return {
            name: [
                self._training(place / name / f"seed_{s}", values, s, steps)
                for s in self.config.seeds
            ]
            for name, values in settings.items()
        }

    def _asked(self, done: int) -> list[Any]:
        """The trials of a round; those that an interrupted run has asked for are among them."""
        end = min(done + self.config.together, self.config.trials)
        known, asked = self.study.trials, []
        for number in range(done, end):
            # A sampler of its own: its random numbers do not depend on an earlier interruption.
            seed = 10_000 * self.config.seed + number
            self.study.sampler = self._optuna.samplers.TPESampler(seed=seed)
            if number < len(known):  # taken up again by its number in the storage
                trial = self._optuna.trial.Trial(self.study, known[number]._trial_id)
            else:
                trial = self.study.ask()
            for name, space in self.config.space.items():
                space.suggested(trial, name)
            asked.append(trial)
        return asked

    def _round(self, trials: Sequence[Any]) -> list[Ended]:
        """Runs trials, then tells the study of them in their order."""
        jobs = {trial.number: self._job(trial.number, trial.params) for trial in trials}
        self._train(list(jobs.values()))
        ended = [self._judged(trial, jobs[trial.number]) for trial in trials]
        for trial, end in zip(trials, ended, strict=True):
            known = self.study.trials[trial.number].intermediate_values
            for step in range(len(known), len(end.curve)):
                trial.report(end.curve[step], step)
            state = self._optuna.trial.TrialState
            if end.state == "complete":
                self.study.tell(trial, max(end.curve))
            else:
                self.study.tell(trial, state=state.PRUNED if end.state == "pruned" else state.FAIL)
        return ended

    def _train(self, jobs: Sequence[Job]) -> None:
        """Runs jobs until each has an outcome or is pruned."""
        waiting = [job for job in jobs if not job.done and not self._kept(curve(job.folder))]
        with Running(self.config.workers, self.config) as running:
            while waiting or running.free < running.workers:
                while waiting and running.free:
                    running.start(waiting.pop(0))
                time.sleep(POLL)
                for job, _, outcome in running.poll():
                    if outcome and outcome.status == LOST:
                        raise ValueError(f"{job.name}: {outcome.last_words}")
                    if not outcome and self._kept(curve(job.folder)):
                        running.stop(job)

    def _judged(self, trial: Any, job: Job) -> Ended:
        values = curve(job.folder)
        if kept := self._kept(values):
            return Ended(trial.number, trial.params, values[:kept], "pruned")
        done = read_outcome(job.folder).get("status") == "done" and values
        return Ended(trial.number, trial.params, values, "complete" if done else "failed")

    def _kept(self, values: Sequence[float]) -> int:
        """Validations after which a trial is pruned; 0 where it is not.

        Found from the values alone, however many more there are by now.
        """
        for count in range(1, min(len(values), self.config.validations - 1) + 1):
            seen = self._optuna.trial.create_trial(
                state=self._optuna.trial.TrialState.RUNNING,
                intermediate_values=dict(enumerate(values[:count])),
            )
            if self._pruner.prune(self.study, seen):
                return count
        return 0

    def _job(self, number: int, values: Mapping[str, Any]) -> Job:
        folder = self.config.folder / "trials" / f"{number:04d}"
        # Settings that make a training fail are an outcome of the search.
        return self._training(folder, values, self.config.seed, self.config.steps, final=True)

    def _training(
        self, folder: Path, values: Mapping[str, Any], seed: int, steps: int, final: bool = False
    ) -> Job:
        config = self.config
        options = (
            *config.policy,
            f"ppo.steps={steps}",
            f"validations={config.validations}",
            "checkpoint_batches=1",  # a validation is seen when it is logged, at a checkpoint
            *(f"{name}={value}" for name, value in values.items()),
            f"seed={seed}",
            f"ppo.seed={seed}",
            f"output={folder}",
        )
        return Job(
            f"{folder.parent.name} {folder.name}",
            folder,
            (str(self._script), *options),
            final=final,
            work=steps,
            checkpoint=CHECKPOINT,
            share=partial(share_trained, folder, steps),
        )


def curve(folder: Path) -> list[float]:
    """Waypoints on the selection paths, validation after validation, of a training so far."""
    file = folder / VALIDATED
    if not file.exists():
        return []
    rows = (line.split(",") for line in file.read_text().splitlines() if "," in line)
    # A training killed between log and checkpoint logs a validation twice, with the same value.
    return list({steps: float(value) for steps, value in rows}.values())


def confirmed(jobs: Mapping[str, Sequence[Job]]) -> dict[str, list[float]]:
    """Setting -> waypoints on the validation paths of its best policy, seed by seed."""
    return {
        name: [row["validation_waypoints"] for row in validations([job.folder for job in own])]
        for name, own in jobs.items()
    }


def _name(trial: Any) -> str:
    return {"COMPLETE": "complete", "PRUNED": "pruned"}.get(trial.state.name, "failed")
