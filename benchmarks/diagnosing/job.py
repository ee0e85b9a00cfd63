"""What to measure, and what one process measures of it."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

Row = dict[str, Any]


@dataclass(frozen=True)
class Config:
    """What to measure."""

    parts: list[str] = field(default_factory=lambda: ["speed", "scale", "sysid"])
    """speed: whole diagnoses by simulator; scale: against length and candidates; sysid: peers."""
    simulators: list[str] = field(
        default_factory=lambda: ["reference", "single_track", "learned", "mujoco"]
    )
    """Of speed: an engine's name, a .pt, a .yaml. All but the reference car get baseline drives."""
    model: str = ""
    """The .pt of `learned`; empty trains a small one on drives made in the run."""
    epochs: int = 15
    """Of that training."""
    seconds: float = 45.0
    """Length of each of the two drives of speed and sysid."""
    dead_time: float = 0.06
    """Concealed in the steering of the reference car, for speed and scale [s]."""
    lengths: list[float] = field(default_factory=lambda: [15.0, 90.0, 360.0, 1200.0])
    """Of scale: both drives together [s]."""
    candidates: list[int] = field(default_factory=lambda: [8, 16, 33])
    """Of scale: effects to choose from, the concealed one among them."""
    scale_simulator: str = "reference"
    """Of scale."""
    peers: list[str] = field(
        default_factory=lambda: ["diagnosis", "fit", "fit_all", "sysid", "sysid_all"]
    )
    """Of sysid: `_all` has every parameter free, the others the one that is off."""
    parameter: str = "cornering_stiffness_rear"
    """Of the MuJoCo car, off in the car that is driven for sysid."""
    truth: float = 6.0
    """Its value there."""
    threads: int = 2
    """Of MuJoCo's batch, where the peers fit it; a diagnosis divides rollouts among processes."""
    rounds: int = 1
    """How often everything is measured, each time in new processes; tables show medians."""
    seed: int = 0
    """Of the drives and the cameras."""
    figure: str = ""
    """PNG for the curves of scale; empty draws none."""
    output: str = ""
    """JSON file for the figures; empty writes none."""


@dataclass(frozen=True)
class Job:
    """What one process does."""

    kind: str
    """drives, model, speed, length, candidates or peer."""
    name: str
    """Of the simulator, of the peer, or of the drives."""
    folder: str
    """Where drives and model lie."""
    config: Config
    seconds: float = 0.0
    """Of both drives together."""
    candidates: int = 0
    """Effects to choose from; 0 for the whole library."""

    def file(self, name: str) -> Path:
        """A file in its folder."""
        return Path(self.folder) / name
