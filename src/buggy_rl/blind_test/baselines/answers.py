"""Answers in the form of `diagnosis.json`, as far as they are counted."""

from collections.abc import Mapping, Sequence
from typing import Any

from buggy_rl.diagnosis.answer import Verdict
from buggy_rl.diagnosis.named_effect import NORMAL
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
    """One effect."""
    effect = {"name": name, "confidence": confidence, "parameters": dict(parameters or {})}
    return {"verdict": verdict, "effects": [effect], "notes": list(notes)}


def unnamed(verdict: Verdict, *notes: str) -> dict[str, Any]:
    """No effect, and why."""
    return {"verdict": verdict, "effects": [], "notes": list(notes)}


def number(parameter: EffectParameter, coordinate: float, spread: float) -> dict[str, Any]:
    """Value and 95 % interval, within bounds, of a coordinate and its spread [prior scales]."""
    bounds = parameter.lower, parameter.upper
    ends = sorted(float(parameter.coordinate(bound)) for bound in bounds)
    low, value, high = (
        float(parameter.value_at(min(max(coordinate + k * NORMAL * spread, ends[0]), ends[1])))
        for k in (-1, 0, 1)
    )
    return {"value": value, "low": min(low, high), "high": max(low, high), "unit": parameter.unit}
