"""What is asked of a diagnosis, and every threshold by which it selects and judges."""

from dataclasses import dataclass, field
from typing import Literal

from omegaconf import MISSING


@dataclass(frozen=True)
class SelectionConfig:
    """Thresholds of selection, confidence and verdict.

    Chosen by hand on development cases; where a default rests on a count, its line has it, and
    scripts/ablate.py switches rules off one at a time.

    "Noise" is the standard deviation of a standardised residual under a right simulator; "excess"
    the misfit over 1; a "nat" a natural unit of log likelihood on held-out blocks.
    """

    iterations: int = 6
    """Gauss-Newton iterations of a fit; numerical."""
    screened_first: int = 12
    """Effects fitted after the first screening; numerical."""
    screened_further: int = 6
    """Effects fitted beside those already found; numerical."""
    most_effects: int = 4
    """Effects of one hypothesis at most."""
    restarts: list[float] = field(default_factory=lambda: [-0.3, -0.1, -0.03, 0.03, 0.1, 0.3])
    """[prior scales] offsets of local restarts; half a sample of clock or dead time is a valley."""
    expected_left: float = 0.25
    """Share of the dispersion that the next effect is expected to leave."""

    min_nats: float = 6.0
    """[nats] a hypothesis must gain for each added parameter, whichever block is left out."""
    min_share: float = 0.05
    """Share of the first excess that an effect must close."""
    collinear_share: float = 0.1
    """Share more that it must close where the other effects do the same (times their R^2)."""
    max_baseline_gain: float = 0.2
    """Share of an effect's gain per segment that it may gain on baseline recordings too."""

    sharpness: float = 0.25
    """Factor on nats between alternatives: neighbouring segments are not independent."""
    residual_odds: float = 2.0
    """[nats] against an alternative that leaves e times as much,"""
    share_odds: float = 25.0
    """[nats] and against one that leaves as much more as the first excess."""
    exact: float = 0.01
    """[noise] excess below which nothing is left."""
    least_probability: float = 0.02
    """Alternatives less probable than this are not listed."""
    unknown_share: float = 0.28
    """Share of the first excess left beside no sure name, above which physics is unknown."""
    even_ratio: float = 1.1
    """Closed over unexplained excess at which a name is as likely right as not,"""
    steepness: float = 2.0
    """exponent of that ratio's odds, and of the constancy test's."""
    most_confident: float = 0.99
    """No name is surer."""
    constant_gain: float = 0.02
    """[noise] excess that letting a parameter vary may close without a doubt,"""
    varying_share: float = 0.015
    """beyond that: share of what the effect closes at which it is as likely misspecified."""
    at_bound_factor: float = 0.5
    """On the confidence of an effect whose parameters lie at a bound."""
    misspecified: float = 0.5
    """Probability of constancy below which an effect is reported to vary with a condition."""
    variation_prior: float = 1.0
    """[prior scales] standard deviation of a parameter's change with a condition's sd."""

    undecided: float = 0.5
    """Confidence below which a name is no answer."""
    rivalled: float = 0.1
    """Probability of alternatives above which these data cannot tell."""
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
    """[nats] by which a suggested manoeuvre must tell hypotheses apart."""


DEFAULTS = SelectionConfig()
RATES = (20.0, 200.0)  # [Hz] 50 ms is a car's length at 5 m/s; above 200 Hz nothing was tried


@dataclass(frozen=True)
class DiagnosisConfig:
    """Which simulator is compared with which recordings."""

    simulator: str = MISSING
    """Any engine, .yaml, .pt or file.py:factory."""
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
    baseline recordings show that they are right."""
    car: str = ""
    """The car: a name in configs/cars or a file of one's own; empty for the buggy. Its limits hold
    for the recordings, its numbers for an engine of ours, its speeds for what counts as driven."""
    rate: float = 100.0
    """[Hz] at which recordings are kept and the simulator is stepped, 20 to 200."""
    seconds: float = 1.0
    """Length of a rollout that is fitted [s]."""
    stretches: int = 150
    """Most rollout segments, spread evenly over the recordings."""
    threads: int = 1
    """On which MuJoCo steps its environments. PyTorch has one: on two, steps as small as these
    take twice as long."""
    minutes: float = 10.0
    """[min] that it may take: a slow simulator gets fewer rollouts, and what is lost by that is
    said; 0 for as many as there are."""
    workers: int = 0
    """Processes among which large rollouts are divided; 0 for one a core."""
    method: Literal["stepwise", "joint"] = "stepwise"
    """How hypotheses are searched and judged: one effect after the other by `selection`, or sets
    of effects at once by calibrated probabilities (docs/evidence.md)."""
    selection: SelectionConfig = field(default_factory=SelectionConfig)

    @property
    def dt(self) -> float:
        """Control period [s].

        Raises:
            ValueError: The rate is outside `RATES`.
        """
        if not RATES[0] <= self.rate <= RATES[1]:
            raise ValueError(f"rate={self.rate:g}: must be {RATES[0]:g} to {RATES[1]:g} Hz")
        return 1 / self.rate
