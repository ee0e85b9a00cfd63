"""What a method is asked, with all that the question names opened, and what it may answer.

Answers are in the form of `diagnosis.json`, as far as they are counted.
"""

import hashlib
import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import yaml

from buggy_rl.diagnosis.answer.answer import Verdict
from buggy_rl.diagnosis.answer.named_effect import NORMAL
from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.diagnosis.pipeline import open_case
from buggy_rl.diagnosis.run.case import DiagnosisCase, segments_of
from buggy_rl.diagnosis.run.maker import Maker
from buggy_rl.effects import EFFECTS
from buggy_rl.effects.base import EffectParameter
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import Segments
from buggy_rl.recordings import Recording, load_recordings


@dataclass(frozen=True, eq=False)
class Asked:
    """Simulator and drives of a case."""

    config: DiagnosisConfig
    recordings: list[Recording]
    baseline: list[Recording]
    """Drives on which the simulator was right; empty where none are given."""

    def maker(self, parameters: Mapping[str, float] | None = None) -> Maker:
        """Builds the simulator for a number of environments, once for each number."""
        return Maker.of(self.config, parameters)

    @cached_property
    def ready(self) -> DiagnosisCase:
        """What the diagnosis itself searches: its segments, noise model, library and simulation.

        What the simulator got wrong before anything changed is closed by the same small network
        (`correct`), so that a method sees what is left: what has changed.
        """
        return open_case(self.config, self.recordings, self.baseline)

    @property
    def corrected(self) -> Simulation:
        """Simulation of the simulator, corrected on its baseline as the diagnosis does it."""
        return self.ready.problem.simulation

    def segments(self, recordings: Sequence[Recording], most: int | None = None) -> Segments:
        """Segments of recordings as the question has them, `most` of them, spread evenly."""
        segments = segments_of(recordings, self.config)
        return segments if most is None else segments.spread(most)


@lru_cache(maxsize=1)
def open_question(seen: Path) -> Asked:
    """Opens the folder of what may be seen; the last one stays open, for the next method.

    Raises:
        ValueError: A drive cannot be read.
    """
    question = yaml.safe_load((seen / "question.yaml").read_text())
    for name in ("simulator", "columns", "car"):
        if (seen / question.get(name, "")).is_file():  # a car may have a name instead
            question[name] = str(seen / question[name])
    config = DiagnosisConfig(**question, output="")
    return Asked(
        config,
        _drives(seen, config, config.recordings),
        _drives(seen, config, config.baseline),
    )


def _drives(seen: Path, config: DiagnosisConfig, names: Sequence[str]) -> list[Recording]:
    if not names:
        return []
    recordings, refusals = load_recordings(
        [str(seen / name) for name in names], config.columns or None, config.dt, car=config.car
    )
    if refusals or not recordings:
        raise ValueError(f"{seen}: {'; '.join(map(str, refusals)) or 'there are no drives'}")
    return recordings


Numbers = Mapping[str, Mapping[str, Any]]
"""Parameter -> value, low, high, unit."""


def named(
    verdict: Verdict,
    name: str,
    confidence: float,
    parameters: Numbers | None = None,
    notes: Sequence[str] = (),
) -> dict[str, Any]:
    """Answer that names one effect."""
    return all_named(verdict, [effect_said(name, confidence, parameters)], notes)


def effect_said(name: str, confidence: float, parameters: Numbers | None = None) -> dict[str, Any]:
    """One effect of an answer."""
    return {"name": name, "confidence": confidence, "parameters": dict(parameters or {})}


def all_named(
    verdict: Verdict, effects: Sequence[dict[str, Any]], notes: Sequence[str] = ()
) -> dict[str, Any]:
    """Answer that names effects."""
    return {"verdict": verdict, "effects": list(effects), "notes": list(notes)}


def unnamed(verdict: Verdict, *notes: str) -> dict[str, Any]:
    """No effect, and why."""
    return {"verdict": verdict, "effects": [], "notes": list(notes)}


def parameter_interval(
    parameter: EffectParameter, coordinate: float, spread: float
) -> dict[str, Any]:
    """Value and 95 % interval, within bounds, of a coordinate and its spread [prior scales]."""
    bounds = parameter.lower, parameter.upper
    ends = sorted(float(parameter.coordinate(bound)) for bound in bounds)
    low, value, high = (
        float(parameter.value_at(min(max(coordinate + k * NORMAL * spread, ends[0]), ends[1])))
        for k in (-1, 0, 1)
    )
    return {"value": value, "low": min(low, high), "high": max(low, high), "unit": parameter.unit}


def guess(seen: Path) -> dict[str, Any]:
    """Any effect of the library, or that nothing is missing, each as likely as the others."""
    question = yaml.safe_load((seen / "question.yaml").read_text())
    names = ["", *(question.get("effects") or EFFECTS)]
    # By the drives, not by the case's name: that would be the same guess in every run.
    first = sorted((seen / "recordings").iterdir())[0].read_bytes()
    name = random.Random(hashlib.sha256(first).hexdigest()).choice(names)
    if not name:
        return {"verdict": "no_mismatch", "effects": []}
    effect = {"name": name, "confidence": 1 / len(names), "parameters": {}}
    return {"verdict": "missing_physics", "effects": [effect]}
