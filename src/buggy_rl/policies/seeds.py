"""One policy for each of several seeds, trained as independent jobs.

OUTPUT/seeds.yaml     the config that all share
OUTPUT/seed_N/        what scripts/train_policy.py writes, with the job's log.txt
OUTPUT/seeds.csv      the best validation of each
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import yaml

from buggy_rl.config import plain
from buggy_rl.jobs import Job
from buggy_rl.jobs.launching import Launching
from buggy_rl.policies.actor_critic import load_policy
from buggy_rl.policies.run import PolicyRunConfig, asked

CHECKPOINT = "checkpoint.pt"
LOGGED = Path("csv") / "scalars" / "reward.csv"  # steps, value: grows as a policy is trained


@dataclass(frozen=True)
class TrainingConfig(PolicyRunConfig, Launching):
    """A policy, or one for each seed."""

    seeds: list[int] = field(default_factory=list)
    """Trains one policy for each in OUTPUT/seed_N, `seed` and `ppo.seed` replaced; empty for one
    policy in OUTPUT."""
    workers: int = 2
    """Seeds at a time."""

    def __post_init__(self) -> None:
        if len(set(self.seeds)) < len(self.seeds):
            raise ValueError(f"seeds={self.seeds}: one of them stands there twice")

    @property
    def single(self) -> PolicyRunConfig:
        """The part that is one training."""
        return PolicyRunConfig(**{f.name: getattr(self, f.name) for f in fields(PolicyRunConfig)})


def trainings(config: TrainingConfig, script: Path) -> list[Job]:
    """One job for each seed.

    Args:
        config: With seeds.
        script: `train_policy.py`.
    """
    file = Path(config.output) / "seeds.yaml"
    return [training(file, seed, config, script) for seed in config.seeds]


def training(file: Path, seed: int, config: TrainingConfig, script: Path) -> Job:
    """The job of one seed; `file` is the config that all share, written when one begins."""
    folder, shared = file.parent / f"seed_{seed}", replace(config.single, resume=False)
    own = replace(shared, seed=seed, ppo=replace(shared.ppo, seed=seed))
    options = (f"seed={seed}", f"ppo.seed={seed}", f"output={folder}")
    return Job(
        f"seed {seed}",
        folder,
        (str(script), str(file), *options),
        question=asked(own),
        texts={file: yaml.safe_dump(plain(shared), sort_keys=False)},
        work=config.ppo.steps,
        checkpoint=CHECKPOINT,
        share=partial(share_trained, folder, config.ppo.steps),
    )


def share_trained(folder: Path, steps: int) -> float:
    """How much of its training a policy has behind it, by its log."""
    file = folder / LOGGED
    if not file.exists() or not (lines := file.read_text().splitlines()):
        return 0.0
    return min(int(float(lines[-1].partition(",")[0])) / steps, 1.0)


def validations(folders: Sequence[Path]) -> list[dict[str, Any]]:
    """The validation of the best policy in each folder: one row of `validation_...` a folder."""
    rows = []
    for folder in folders:
        _, about = load_policy(folder / "best.pt")
        values = {k: v for k, v in about.items() if k.startswith("validation_")}
        rows.append({"seed": about["config"]["seed"], "steps": about["steps"], **values})
    return rows
