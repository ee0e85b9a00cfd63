"""The repaired simulator, as the file that every script takes as a simulator."""

import os
from pathlib import Path
from typing import Any

from buggy_rl.diagnosis.pipeline import Diagnosis
from buggy_rl.estimation.baseline import FILE


def repaired(simulator: str, done: Diagnosis, folder: Path) -> dict[str, Any]:
    """The simulator with what was found in it, as content of a simulator file.

    A correction of the baseline stays in it; its network lies beside the file, as `FILE`.

    Args:
        simulator: As it was given.
        done: What was found.
        folder: Of the file.
    """
    content: dict[str, Any] = {"engine": simulator}
    if simulator.endswith((".yaml", ".yml", ".pt")) or ".py:" in simulator:
        content["engine"] = os.path.relpath(simulator, folder)
    if done.step:
        content["options"] = dict(done.step)
    effects, parameters = {}, dict(done.tuned or {})
    if done.correction is not None and done.correction.effect is not None:
        strength = float(done.correction.effect.values["strength"])
        effects[done.correction.effect.name] = {"strength": strength, "model": FILE}
    options = done.case.problem.simulation.options
    inside, realised = done.case.problem.library.inside, {}
    for named in done.answer.effects:
        values = {name: value.value for name, value in named.parameters.items()}
        if named.kind == "parameter":
            parameters = {**values, **parameters}
        elif named.name in inside:
            realised[named.name] = values
        else:
            effects[named.name] = {**values, **options.get(named.name, {})}
    parameters = inside.values(realised, parameters)
    if parameters:
        content["parameters"] = parameters
    if effects:
        content["effects"] = effects
    return content
