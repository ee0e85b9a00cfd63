"""The scripts that a study runs: diagnoses, models, policies, and the simulators of these."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from torchrl.envs import EnvBase

from buggy_rl.core.files import write_atomically
from buggy_rl.jobs import Job
from buggy_rl.policies.training.seeds import CHECKPOINT, share_trained
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.drives import drive_cases
from buggy_rl.proof.cases.simulators import BASELINE_NOISE, save_drives
from buggy_rl.proof.transfer.parameter_posterior import fitted_with_spread, randomised
from buggy_rl.proof.transfer.plan import Trained, TransferConfig

FACTORY = '''"""{simulator}, {name}; written by scripts/transfer.py."""

from functools import partial

from {module} import {name}

make = partial({name}, {simulator!r})
'''


def diagnosis_jobs(config: TransferConfig, scripts: Path) -> list[Job]:
    """A diagnosis of each car, with the drives before the change as its baseline."""
    jobs = []
    for car in config.cars if "repaired" in config.arms else ():
        folder = config.car(car) / "diagnosis"
        options = (
            f"simulator={config.simulator}",
            f"recordings=[{config.car(car) / 'recordings'}]",
            f"baseline=[{config.car(car) / 'baseline'}]",
            *config.diagnosis,
            f"output={folder}",
        )
        command = (str(scripts / "diagnose.py"), *options)
        jobs.append(Job(f"diagnosis, {car}", folder, command, inputs=(config.simulator,)))
    return jobs


def models(config: TransferConfig, scripts: Path) -> list[Job]:
    """A model of each car, learned from the same drives.

    The script needs a held-out drive: it is one of the car before the change.
    """
    jobs = []
    for car in config.cars if "learned" in config.arms else ():
        folder, drives = config.car(car) / "learned", config.car(car)
        options = (
            f"data.recordings=[{drives / 'recordings'},{drives / 'baseline' / 'before_0.csv'}]",
            "data.held_out=[before_0]",
            f"data.validation=[drive_{config.drives - 1}]",
            *config.model,
            f"output={folder}",
        )
        command = (str(scripts / "train_models.py"), *options)
        jobs.append(Job(f"model, {car}", folder, command, inputs=_files(config.model)))
    return jobs


def training_jobs(config: TransferConfig, scripts: Path) -> list[Job]:
    """A policy for each arm, car and seed, all by the same settings."""
    return [_training(config, policy, scripts) for policy in config.policies()]


def _training(config: TransferConfig, policy: Trained, scripts: Path) -> Job:
    folder = config.folder(policy)
    options = (
        *config.policy,
        f"engine.simulator={config.simulator_of(policy.arm, policy.car)}",
        f"ppo.steps={config.steps}",
        f"seed={policy.seed}",
        f"ppo.seed={policy.seed}",
        f"output={folder}",
    )
    return Job(
        ", ".join(str(part) for part in policy if part != ""),
        folder,
        (str(scripts / "train_policy.py"), *options),
        inputs=(*_files(config.policy), config.made_from(policy.arm, policy.car)),
        work=config.steps,
        checkpoint=CHECKPOINT,
        share=partial(share_trained, folder, config.steps),
    )


def _files(options: list[str]) -> tuple[str, ...]:
    """Files among a script's options."""
    return tuple(option for option in options if option.endswith((".yaml", ".yml")))


def write_factories(config: TransferConfig) -> None:
    """Writes the simulators of every arm whose environments differ in their parameters."""
    for arm, car in config.places():
        if (file := config.factory(arm, car)) is not None:
            draw = randomised if arm == "randomised" else fitted_with_spread
            write_factory(draw, config.made_from(arm, car), file)


def write_factory(draw: Callable[..., EnvBase], simulator: str, file: Path) -> None:
    """Writes `FILE:make`, a simulator as every script takes it: `draw` of this simulator."""
    text = FACTORY.format(simulator=simulator, module=draw.__module__, name=draw.__name__)
    write_atomically(file, text)


def recorded(case: Case, folder: Path) -> bool:
    """Whether a car's recordings are all there."""
    kinds = {"recordings": "drive", "baseline": "before"}
    return all(
        (folder / kind / f"{name}_{number}.csv").exists()
        for kind, name in kinds.items()
        for number in range(case.drives)
    )


def record(cases: Sequence[Case], folders: Sequence[Path]) -> None:
    """Drives cars in one batch and writes `recordings/` and `baseline/` into the folder of each.

    The cases are of one plant and length, with baseline drives.
    """
    for case, folder, motion in zip(cases, folders, drive_cases(cases), strict=True):
        assert motion.clean is not None
        changed = {f"drive_{n}": n for n in range(case.drives)}
        before = {f"before_{n}": BASELINE_NOISE + n for n in range(case.drives)}
        save_drives(case, motion.changed[: case.drives], folder / "recordings", changed)
        save_drives(case, motion.clean, folder / "baseline", before, changed=False)
