"""The drives and the scripts that a study runs: fits, models, diagnoses, trainings."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

from buggy_rl.jobs import Job
from buggy_rl.policies.training.seeds import CHECKPOINT, share_trained
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.drives import drive_cases
from buggy_rl.proof.cases.simulators import BASELINE_NOISE, PREPARING, save_drives
from buggy_rl.proof.transfer.arms import ARMS
from buggy_rl.proof.transfer.plan import Trained, TransferConfig

KEPT_BACK = ("earlier_0", "earlier_1")  # judges a model; stops its training


def recorded(config: TransferConfig, car: str) -> bool:
    """Whether a car's recordings are all there."""
    kinds = (
        ("recordings", "drive", config.drives),
        ("baseline", "before", config.drives),
        ("earlier", "earlier", config.earlier),
    )
    return all(
        (config.car(car) / folder / f"{name}_{number}.csv").exists()
        for folder, name, count in kinds
        for number in range(count)
    )


def record(config: TransferConfig, cases: Mapping[str, Case]) -> None:
    """Drives cars in two batches, before and after the change, and writes their recordings."""
    before = [
        replace(case, concealed={}, baseline=False, drives=config.earlier)
        for case in cases.values()
    ]
    motions = zip(
        cases.items(), drive_cases(list(cases.values())), drive_cases(before), strict=True
    )
    for (car, case), motion, earlier in motions:
        assert motion.clean is not None
        folder, count = config.car(car), range(config.drives)
        changed = {f"drive_{n}": n for n in count}
        save_drives(case, motion.changed, folder / "recordings", changed)
        clean = {f"before_{n}": BASELINE_NOISE + n for n in count}
        save_drives(case, motion.clean, folder / "baseline", clean, changed=False)
        numbers = {f"earlier_{n}": PREPARING + n for n in range(config.earlier)}
        save_drives(case, earlier.changed, folder / "earlier", numbers, changed=False)


def fit_jobs(config: TransferConfig, scripts: Path) -> list[Job]:
    """Fits of each car, before the change and after it, by as many drives and the same options."""
    jobs = []
    for car in config.names:
        own, kept = config.car(car), [f"earlier/{name}.csv" for name in KEPT_BACK]
        wanted = (("fit", ["earlier"]), ("refit", ["recordings", *kept]))
        for folder, drives in wanted if config.needs("refit") else wanted[:1]:
            options = _study(own, drives, KEPT_BACK[1], config.fit, folder)
            command = (str(scripts / "fit_mujoco.py"), *options)
            jobs.append(Job(f"{folder}, {car}", own / folder, command, inputs=_files(config.fit)))
    return jobs


def model_jobs(config: TransferConfig, scripts: Path) -> list[Job]:
    """Models of each car, of the earlier drives and of those with the two minutes after."""
    made = (
        ("before", ["earlier"], KEPT_BACK[1], ("before",)),
        ("learned", ["recordings", "earlier"], f"drive_{config.drives - 1}", ("learned", "model")),
    )
    jobs = []
    for car in config.names:
        for folder, drives, stops, needed in made:
            if config.needs(*needed):
                own = config.car(car)
                options = _study(own, drives, stops, config.model, folder)
                command, inputs = (str(scripts / "train_models.py"), *options), _files(config.model)
                jobs.append(Job(f"{folder}, {car}", own / folder, command, inputs=inputs))
    return jobs


def _study(own: Path, drives: list[str], stops: str, options: list[str], to: str) -> list[str]:
    """Options of a study of a car's drives; one that none is made of judges."""
    return [
        f"data.recordings=[{','.join(str(own / part) for part in drives)}]",
        f"data.held_out=[{KEPT_BACK[0]}]",
        f"data.validation=[{stops}]",
        *options,
        f"output={own / to}",
    ]


def diagnosis_jobs(config: TransferConfig, scripts: Path) -> list[Job]:
    """A diagnosis of each car's fit, with the drives before the change as its baseline."""
    jobs = []
    for car in config.names if config.needs("repair", "placebo") else ():
        own = config.car(car)
        options = (
            f"simulator={config.fitted(car)}",
            f"recordings=[{own / 'recordings'}]",
            f"baseline=[{own / 'baseline'}]",
            *config.diagnosis,
            f"output={own / 'diagnosis'}",
        )
        command = (str(scripts / "diagnose.py"), *options)
        inputs = (str(config.fitted(car)),)
        jobs.append(Job(f"diagnosis, {car}", own / "diagnosis", command, inputs=inputs))
    return jobs


def training_jobs(config: TransferConfig, scripts: Path, started: bool) -> list[Job]:
    """A policy for each arm, car and seed: those that begin anew, or those that are `started`."""
    return [
        _training(config, policy, scripts)
        for policy in config.policies()
        if bool(ARMS[policy.arm].start) == started
    ]


def _training(config: TransferConfig, policy: Trained, scripts: Path) -> Job:
    folder, steps, start = config.folder(policy), config.steps_of(policy.arm), []
    layers = list(config.policy)
    if begins := ARMS[policy.arm].start:
        start = [str(config.folder(policy._replace(arm=begins)) / "best.pt")]
        layers += config.continued
    simulator = config.simulator_of(policy.arm, policy.car)
    options = (
        *layers,
        *(f"start={file}" for file in start),
        f"engine.simulator={simulator}",
        *(f"{settings}={steps}" for settings in ("shac.steps", "ppo.steps")),
        *(f"{name}={policy.seed}" for name in ("seed", "shac.seed", "ppo.seed")),
        f"output={folder}",
    )
    return Job(
        ", ".join(str(part) for part in policy),
        folder,
        (str(scripts / "train_policy.py"), *options),
        inputs=(*_files(layers), simulator, *start),
        work=steps,
        checkpoint=CHECKPOINT,
        share=partial(share_trained, folder, steps),
    )


def _files(options: list[str]) -> tuple[str, ...]:
    """Files among a script's options."""
    return tuple(option for option in options if option.endswith((".yaml", ".yml")))
