"""What a whole study does beside fitting and comparing simulators."""

from dataclasses import dataclass, field, fields
from typing import Literal

from buggy_rl.identification.study import StudyConfig
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
    """That the film shows."""


@dataclass(frozen=True)
class WholeStudyConfig(StudyConfig, Launching):
    """Everything from a folder of recordings to study.html."""

    title: str = ""
    """Of the page; empty for the name of the output folder."""
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
