"""What is asked of a diagnosis, and the numerical settings of its search."""

from dataclasses import dataclass, field
from typing import Any

from omegaconf import MISSING

from buggy_rl.effects import refuse_unknown_effects


@dataclass(frozen=True)
class SearchConfig:
    """Numerical settings of the search, and what is reported beside the probabilities.

    What is named, and how surely, is decided by the weights of `calibration.yaml` alone.
    """

    iterations: int = 10
    """Gauss-Newton iterations of a fit; numerical."""
    restarts: list[float] = field(default_factory=lambda: [-0.3, -0.1, -0.03, 0.03, 0.1, 0.3])
    """[prior scales] offsets of local restarts; half a sample of clock or dead time is a valley."""
    expected_left: float = 0.25
    """Share of the dispersion that the next effect is expected to leave."""
    variation_prior: float = 1.0
    """[prior scales] standard deviation of a parameter's change with a condition's sd."""
    moved: float = 0.1
    """[prior scales] by which a re-tuned parameter must have moved to be wrong,"""
    certain: float = 2.0
    """[standard deviations] and by which."""
    finer_step_gain: float = 0.1
    """[noise] by which half the integration step must come closer to be adopted; five development
    cases with a coarse step gained 0.11 to 0.34, of 46 others 45 at most 0.06 and one 0.101."""
    depends_share: float = 0.05
    """Share of the unexplained variance that a condition must explain to be named."""
    deciding_nats: float = 10.0
    """[nats] by which predictions differ, on average, that these recordings tell apart."""


DEFAULTS = SearchConfig()
RATES = (20.0, 200.0)  # [Hz] 50 ms is a car's length at 5 m/s; above 200 Hz nothing was tried


@dataclass(frozen=True)
class DiagnosisConfig:
    """Which simulator is compared with which recordings."""

    simulator: Any = MISSING
    """Any engine, .yaml, .pt or file.py:factory; in Python a factory itself, too, which is stepped
    in one process."""
    recordings: list[str] = MISSING
    """Files and folders that it should have predicted."""
    baseline: list[str] = field(default_factory=list)
    """Recordings on which it was right; then what is reported is what changed."""
    output: str = MISSING
    """Folder for diagnosis.json, repaired.yaml and report.html."""
    columns: str = ""
    """YAML column map, for tables that do not have the standard columns."""
    effects: list[str] = field(default_factory=list)
    """Effects to choose from; empty for the whole library. A user's own as file.py:Class."""
    parameters: bool | None = None
    """Whether the simulator's own parameters may be what is wrong; by default they may unless
    baseline recordings show that they are right. false: a black box, of which no effect is realised
    inside either."""
    car: str = ""
    """The car: a name in configs/cars or a file of one's own; empty for the buggy. Its limits hold
    for the recordings, its numbers for an engine of ours, its speeds for what counts as driven."""
    rate: float = 100.0
    """[Hz] at which recordings are kept and the simulator is stepped, 20 to 200."""
    seconds: float = 1.0
    """Length of a rollout that is fitted [s]."""
    stretches: int = 60
    """Most rollout segments, spread evenly over the recordings."""
    threads: int = 1
    """Threads on which MuJoCo steps its environments. PyTorch has one: on two, steps as small as
    these take twice as long."""
    minutes: float = 10.0
    """[min] that it may take: a slow simulator gets fewer rollouts, rounds that no time is left for
    are left out, and what is lost by that is said. Of an interrupted diagnosis that goes on, this
    sitting counts alone. Commands that do not predict the motion get the shortest search. 0 for as
    many rollouts as there are."""
    workers: int = 0
    """Processes among which large rollouts are divided; 0 for one a core."""
    search: SearchConfig = field(default_factory=SearchConfig)

    def __post_init__(self) -> None:
        refuse_unknown_effects(self.effects)

    @property
    def dt(self) -> float:
        """Control period [s].

        Raises:
            ValueError: The rate is outside `RATES`.
        """
        if not RATES[0] <= self.rate <= RATES[1]:
            raise ValueError(f"rate={self.rate:g}: must be {RATES[0]:g} to {RATES[1]:g} Hz")
        return 1 / self.rate
