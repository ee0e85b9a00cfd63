"""What a sweep searches, and how long."""

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from omegaconf import MISSING

from buggy_rl.jobs.launching import Launching


@dataclass(frozen=True)
class Range:
    """Values of one option."""

    low: float = 0.0
    """Smallest."""
    high: float = 0.0
    """Largest."""
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
    space: dict[str, Range] = field(default_factory=dict)
    """Options that are searched, as "ppo.learning_rate": {low: 1e-4, high: 1e-2, log: true}."""
    steps: int = 1_000_000
    """PPO steps of a trial."""
    validations: int = 6
    """Of each trial; after each it may be pruned."""
    trials: int = 48
    """In all."""
    together: int = 8
    """Trials of a round; more than `workers` waste nothing but proposals."""
    startup: int = 8
    """Complete trials before one is pruned."""
    best: int = 3
    """Settings that are trained again with further seeds."""
    seeds: list[int] = field(default_factory=lambda: [1, 2, 3, 4, 5])
    """Those seeds."""
    confirm_steps: int = 0
    """PPO steps of each of them; 0: as many as a trial. What learns fastest in a short trial need
    not be the best of a whole training."""
    seed: int = 0
    """Of the search, and of every trial's training."""
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
        """Of the sweep."""
        return Path(self.output)

    @property
    def question(self) -> str:
        """Digest of all that a trial depends on."""
        spaces = {name: vars(values) for name, values in self.space.items()}
        asked = [self.policy, spaces, self.steps, self.validations, self.together, self.startup]
        return hashlib.sha256(json.dumps([*asked, self.seed]).encode()).hexdigest()
