"""One blind case: an effect drawn at random is concealed in a car, diagnosed, and revealed."""

import random
from dataclasses import dataclass, field
from pathlib import Path

import torch
from omegaconf import MISSING
from tensordict import TensorDict
from torch import Tensor

from buggy_rl.core import keys
from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.diagnosis.run.maker import Maker
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import Segments, cut_segments
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.draw import DrawConfig, draw
from buggy_rl.proof.cases.sealing import CaseStore
from buggy_rl.proof.plants import abilities
from buggy_rl.recordings import load_recordings

FIRST, SEEDS = 10_000_000, 80_000_000  # no case of scripts/prove.py has one of these seeds
SHOWN = 3.0  # [s] length of the rollouts that are drawn
STRIDE = 0.5  # [s] between their starts
MEASURED = "car"


@dataclass(frozen=True)
class BlindDemoConfig:
    """Something concealed in the reference car."""

    output: str = MISSING
    """Folder of drives, answer and picture; what is sealed lies in OUTPUT_sealed."""
    seed: int = -1
    """Seed of the case; below 0: that of the case in OUTPUT, or a random one."""
    effects: int = 1
    """How many are concealed, 0 to 3."""
    seconds: float = 45.0
    """Length of each of the two drives."""
    more: list[str] = field(default_factory=list)
    """Further options of scripts/diagnose.py."""

    def __post_init__(self) -> None:
        if not 0 <= self.effects <= 3:
            raise ValueError(f"effects is {self.effects}: must be 0 to 3")

    @property
    def store(self) -> CaseStore:
        """Store of the case."""
        return CaseStore(Path(self.output), Path(f"{self.output}_sealed"))


def draw_case(config: BlindDemoConfig) -> Case:
    """The case of the config's seed."""
    seed = config.seed
    if seed < 0:
        before = sorted(config.store.sealed.glob("*.json"))
        seed = int(before[0].stem) - FIRST if before else random.SystemRandom().randrange(SEEDS)
    settings = DrawConfig(
        families=[("nothing", "one", "two", "three")[config.effects]],
        pairings=["reference"],
        nuisances=["white"],
        driving=["rich"],
        seconds=[config.seconds],
    )
    return draw(FIRST + seed, settings, {"reference": abilities("reference")})


def demo_rollouts(store: CaseStore, case: Case) -> dict[str, TensorDict]:
    """The held-out drive, and what simulators make of its commands.

    Returns:
        `car`, `as given`, `repaired` -> `pose` and `velocity` [N, H + 1, 3] as the sensor shows
        them, positions relative to the start of the rollout.
    """
    recordings, _ = load_recordings([str(store.held_out(case.id))])
    segments = cut_segments(recordings, SHOWN, STRIDE)
    measured = segments.motion_from_start
    files = {
        "as given": store.inputs(case.id) / "simulator.yaml",
        "repaired": store.diagnosis(case.id) / "repaired.yaml",
    }
    shown = {MEASURED: measured} | {n: measured + _residuals(f, segments) for n, f in files.items()}
    return {name: _with_start(rows) for name, rows in shown.items()}


def position_error(made: TensorDict, measured: TensorDict, seconds: float = 1.0) -> float:
    """Root mean square [m] between where rollouts are after so long and where the car was."""
    row = round(seconds / CONTROL_PERIOD)
    off = (made[keys.POSE] - measured[keys.POSE])[:, row, :2]
    return float(off.square().sum(-1).mean().sqrt())


def _residuals(file: Path, segments: Segments) -> Tensor:
    simulation = Simulation(Maker(str(file)), every=1)
    return simulation.residuals(segments)[0]


def _with_start(rows: Tensor) -> TensorDict:
    """Rows with the start itself as the first one."""
    begin = torch.cat([torch.zeros_like(rows[:, :1, :3]), rows[:, :1, 3:]], -1)
    whole = torch.cat([begin, rows], 1)
    return TensorDict({keys.POSE: whole[..., :3], keys.VELOCITY: whole[..., 3:]}, whole.shape[:2])
