"""Answers in the form of `diagnosis.json`, as far as they are counted."""

import hashlib
import random
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from buggy_rl.diagnosis.answer.answer import Verdict
from buggy_rl.diagnosis.search.posterior import NORMAL
from buggy_rl.effects import EFFECTS
from buggy_rl.effects.base import EffectParameter

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
    effect = {"name": name, "confidence": confidence, "parameters": dict(parameters or {})}
    return {"verdict": verdict, "effects": [effect], "notes": list(notes)}


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
