"""One whole diagnosis, as a script runs it, and whether it was right."""

import os
import time
from collections.abc import Sequence

from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.diagnosis.pipeline import run_diagnosis
from buggy_rl.effects import EFFECTS
from buggy_rl.task.env import make_simulator
from diagnosing.drives import CHANGED, OFF, RIGHT, load
from diagnosing.job import Job, Row

TRUTH = "steering_dead_time"
OWN = "parameter:"  # begins the name of a parameter that the simulator declares


def diagnosis_row(job: Job) -> Row:
    """Time, stages and answer of a diagnosis of the reference car's concealed dead time."""
    baseline = not job.name.startswith("reference")
    config = DiagnosisConfig(
        simulator=simulator(job),
        recordings=[str(job.file(CHANGED))],
        baseline=[str(job.file(RIGHT))] if baseline else [],
        output=job.folder,
        effects=choice(job.candidates),
        parameters=False,  # a black box: effects alone
    )
    return {
        "truth": job.config.dead_time,
        "baseline": baseline,
        **measured(config, job, CHANGED, (TRUTH, OWN + TRUTH)),
    }


def own_parameter_row(job: Job) -> Row:
    """The same of the MuJoCo car with a parameter off, told nothing about which."""
    config = DiagnosisConfig(
        simulator="mujoco",
        recordings=[str(job.file(OFF))],
        output=job.folder,
    )
    return measured(config, job, OFF, (OWN + job.config.parameter,))


def measured(config: DiagnosisConfig, job: Job, drives: str, right: Sequence[str]) -> Row:
    """Runs a diagnosis.

    Args:
        config: Of it.
        job: Says how much of the drives.
        drives: Kind of drives.
        right: Names of which the first effect has to have one; each of a single number.
    """
    recordings = load(job.file(drives), job.seconds)
    baseline = load(job.file(RIGHT), job.seconds) if config.baseline else []
    stages: list[tuple[float, str]] = []
    begin, cpu = time.perf_counter(), sum(os.times()[:4])
    done = run_diagnosis(
        config, recordings, lambda text: stages.append((time.perf_counter(), text)), baseline
    )
    end, used = time.perf_counter(), sum(os.times()[:4]) - cpu
    names = [effect.name for effect in done.answer.effects]
    found = next((e for e in done.answer.effects if e.name in right), None)
    value = next(iter(found.parameters.values())) if found else None
    return {
        "seconds": end - begin,
        "cpu_seconds": used,
        "candidates": candidates(config),
        "stages": by_stage(stages, end),
        "verdict": done.answer.verdict,
        "named": names,
        "right": bool(names) and names[0] in right,
        "value": value and value.value,
        "low": value and value.low,
        "high": value and value.high,
        "confidence": found and found.confidence,
    }


def choice(count: int) -> list[str]:
    """So many effects from all over the library, the true one among them; 0 for all."""
    if not count:
        return []
    if not 1 <= count <= len(EFFECTS):
        raise ValueError(f"candidates={count}: the library has 1 to {len(EFFECTS)} effects")
    others = [name for name in EFFECTS if name != TRUTH]
    picked = {others[k * len(others) // (count - 1)] for k in range(count - 1)}
    return [name for name in EFFECTS if name == TRUTH or name in picked]


def candidates(config: DiagnosisConfig) -> int:
    """Effects and parameters that a diagnosis chooses from."""
    own = not config.baseline if config.parameters is None else config.parameters
    declared = getattr(make_simulator(config.simulator, 1), "declared", {}) if own else {}
    return len(config.effects or EFFECTS) + len(declared)


def by_stage(begun: Sequence[tuple[float, str]], end: float) -> dict[str, float]:
    """Seconds spent under each text of progress, the counts in it left out."""
    ends = [time for time, _ in begun[1:]] + [end]
    result: dict[str, float] = {}
    for (begin, text), until in zip(begun, ends, strict=True):
        stage = " ".join(word for word in text.split() if not word.isdigit())
        result[stage] = result.get(stage, 0.0) + until - begin
    return result


def simulator(job: Job) -> str:
    """What a diagnosis is given: a model's file, or an engine's name."""
    if job.name == "learned":
        return job.config.model or str(job.file("model.pt"))
    return job.name
