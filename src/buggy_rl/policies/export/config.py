"""What is exported, and how closely the car's runtime has to agree."""

from dataclasses import dataclass, field

from omegaconf import MISSING


@dataclass(frozen=True)
class ExportConfig:
    """A policy for the car's computer."""

    policy: str = MISSING
    """best.pt or last.pt of scripts/train_policy.py."""
    output: str = MISSING
    """Common part of the files: OUTPUT.npz, OUTPUT.json, OUTPUT.onnx."""
    course: list[str] = field(default_factory=lambda: ["lap", "infinity"])
    """Paths written beside them as CSV: lap, infinity, random, or a .csv with columns x, y [m]."""
    training_only: list[str] = field(default_factory=list)
    """Places of the task with transforms of your own that change neither observation nor command;
    they stay in the comparison."""
    tolerance: float = 1e-5
    """Largest difference between the car's runtime and training, in the unit of each number."""
    random_steps: int = 1000
    """Steps on random poses and velocities that are compared."""
    seed: int = 0
    """Of those."""
    threads: int = 1
    """Threads of PyTorch."""

    def __post_init__(self) -> None:
        if not 0 < self.tolerance <= 1e-3:
            raise ValueError(f"tolerance={self.tolerance:g}: must be in (0, 1e-3]")
        if self.random_steps < 1:
            raise ValueError(f"random_steps={self.random_steps}: must be at least 1")
