"""What is asked: which simulator, which drives."""

from dataclasses import dataclass, field

from omegaconf import MISSING


@dataclass(frozen=True)
class DiagnosisConfig:
    """What is compared with what."""

    simulator: str = MISSING
    """Any engine, .yaml, .pt or file.py:factory."""
    recordings: list[str] = MISSING
    """Drives that it should have foretold."""
    baseline: list[str] = field(default_factory=list)
    """Drives on which it was right; then what is reported is what changed."""
    output: str = MISSING
    """Folder for diagnosis.json, repaired.yaml and report.html."""
    columns: str = ""
    """YAML column map, for tables that do not have the standard columns."""
    effects: list[str] = field(default_factory=list)
    """Effects to choose from; empty for the whole library. One's own as file.py:Class."""
    parameters: bool | None = None
    """Whether the simulator's own parameters may be what is wrong; if not said, they may unless
    baseline drives show that they are right."""
    seconds: float = 1.0
    """Length of a rollout that is fitted."""
    stretches: int = 150
    """Most of them, spread evenly over the drives."""
    threads: int = 1
    """On which MuJoCo steps its cars. PyTorch has one: on two, steps as small as these take twice
    as long."""
