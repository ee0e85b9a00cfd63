"""The repaired simulator, as the file that every script takes as a simulator."""

import os
from copy import deepcopy
from pathlib import Path
from typing import Any

from buggy_rl.diagnosis.pipeline import Diagnosed
from buggy_rl.effects.residual import ResidualAcceleration
from buggy_rl.estimation.baseline import FILE
from buggy_rl.estimation.hypothesis import OWN


def repaired_simulator(simulator: str, done: Diagnosed, folder: Path) -> dict[str, Any]:
    """The simulator with the repair that was validated, as content of a simulator file.

    What was learned, on the baseline or as the last layer, is in it; the network lies beside the
    file, as `FILE`.

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
    effects: dict[str, Any] = {}
    if learned := learned_of(done):
        effects[learned.name] = {"strength": float(learned.values["strength"]), "model": FILE}
    options = done.case.problem.simulation.options
    inside = done.case.problem.library.inside
    parameters: dict[str, float] = {}
    realised: dict[str, Any] = {}
    for name, values in done.answer.repair.values.items():
        if name.startswith(OWN):
            parameters |= values
        elif name in inside:
            realised[name] = values
        else:
            # A copy: what effects share would be written once, and referred to by `*id001`.
            effects[name] = {**values, **deepcopy(options.get(name, {}))}
    parameters = inside.values(realised, parameters)
    if parameters:
        content["parameters"] = parameters
    if effects:
        content["effects"] = effects
    return content


def learned_of(done: Diagnosed) -> ResidualAcceleration | None:
    """What is learned in a repaired simulator: its last layer, or the correction of a baseline."""
    if (network := done.answer.repair.residual) is not None:
        dt = done.case.problem.segments.dt
        return ResidualAcceleration(model=network, strength=1.0, dt=dt)
    return None if done.correction is None else done.correction.effect
