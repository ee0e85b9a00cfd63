"""The simulator as it is given back."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from buggy_rl.diagnosis.answer import Answer
from buggy_rl.estimation.baseline import FILE, Correction
from buggy_rl.estimation.rollout import Options


def repaired(
    simulator: str,
    answer: Answer,
    folder: Path,
    correction: Correction | None = None,
    options: Options | None = None,
    tuned: Mapping[str, float] | None = None,
    step: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """The simulator with what was found in it, as a simulator file has it.

    A correction stays in it as what it is; its network lies beside the file, as `FILE`.

    Args:
        simulator: As it was given.
        answer: What was found in it.
        folder: Of the file.
        correction: Of what it got wrong before anything changed.
        options: What its effects had to know of it.
        tuned: All its own parameters, where it was re-tuned.
        step: Its options, where it had to integrate more finely.
    """
    content: dict[str, Any] = {"engine": simulator}
    if simulator.endswith((".yaml", ".yml", ".pt")) or ".py:" in simulator:
        content["engine"] = os.path.relpath(simulator, folder)
    if step:
        content["options"] = dict(step)
    effects, parameters = {}, dict(tuned or {})
    if correction is not None and correction.effect is not None:
        strength = float(correction.effect.values["strength"])
        effects[correction.effect.name] = {"strength": strength, "model": FILE}
    for named in answer.effects:
        values = {name: value.value for name, value in named.parameters.items()}
        if named.kind == "parameter":
            parameters = {**values, **parameters}
        else:
            effects[named.name] = {**values, **(options or {}).get(named.name, {})}
    if parameters:
        content["parameters"] = parameters
    if effects:
        content["effects"] = effects
    return content
