"""Files of the simulators that policies are trained in, made from fits, repairs and models."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from buggy_rl.core.files import write_atomically
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.drives import plant_parameters
from buggy_rl.proof.transfer.answer_posterior import repaired_with_spread
from buggy_rl.proof.transfer.arms import ARMS, Arm
from buggy_rl.proof.transfer.parameter_posterior import randomised
from buggy_rl.proof.transfer.plan import TransferConfig
from buggy_rl.simulators import make_engine, read_simulator
from buggy_rl.simulators.base import Engine

FACTORY = '''"""{simulator}, {name}; written by scripts/transfer.py."""

from functools import partial

from {module} import {name}

make = partial({name}, {arguments})
'''
PATHS = (".yaml", ".yml", ".pt")


def write_simulators(config: TransferConfig, cases: Mapping[str, Case]) -> None:
    """Writes the simulators of all arms, for the cars that policies are trained for.

    Args:
        config: Of the study; its fits, models and diagnoses are there.
        cases: All cars by name, in their order.

    Raises:
        ValueError: A file that one is made from is missing.
    """
    for car in config.trained_cars:
        for name in config.arms:
            arm = ARMS[name]
            content = _content(config, car, cases[car], arm, _lender(cases, car))
            if arm.gradient:
                content = through_surrogate(content, config.model_of(car, arm.gradient))
            file = config.car(car) / "simulators" / f"{name}.yaml"
            write_atomically(file, yaml.safe_dump(beside(content, file.parent), sort_keys=False))
            if arm.drawn:
                _write_factory(config, car, arm, file)


def _content(config: TransferConfig, car: str, case: Case, arm: Arm, lender: str) -> dict[str, Any]:
    """What an arm's simulator is without its gradients, as content of a simulator file."""
    if arm.base == "model":
        return {"engine": str(config.model_of(car, "learned"))}
    if arm.base == "car":
        return car_itself(case)
    if arm.base == "placebo":
        own, other = config.fitted(car), config.fitted(lender)
        return other_repair(own, other, config.repaired(lender))
    files = {
        "fit": config.fitted(car),
        "refit": config.fitted(car, "refit"),
        "repair": config.repaired(car),
    }
    file = files[arm.base]
    return {"engine": str(file)} if arm.base != "repair" else read_simulator(file)


def _lender(cases: Mapping[str, Case], car: str) -> str:
    """The car whose repair a placebo has: the next one that is changed as this one is, or not."""
    alike = [c for c, case in cases.items() if bool(case.concealed) == bool(cases[car].concealed)]
    return alike[(alike.index(car) + 1) % len(alike)]


def through_surrogate(content: Mapping[str, Any], model: Path) -> dict[str, Any]:
    """A simulator with the derivatives of a model in place of its own; effects stand over it.

    Args:
        content: Of a simulator file.
        model: File of a learned model.
    """
    own = {"simulator": content["engine"], "model": str(model)}
    made = {"engine": "surrogate", "options": own | content.get("options", {})}
    return made | {key: content.get(key, {}) for key in ("parameters", "effects")}


def car_itself(case: Case) -> dict[str, Any]:
    """The changed car as a simulator, seen without a camera."""
    numbers = {name: round(value, 8) for name, value in plant_parameters(case).items()}
    return {"engine": case.plant, "options": {"faults": case.faults}, "parameters": numbers}


def other_repair(own: Path, other: Path, repaired: Path) -> dict[str, Any]:
    """A fitted simulator with the repair of another one.

    Its effects, and parameters moved by as much as the repair moved them there, within their range.

    Args:
        own: The fitted simulator.
        other: The one that was repaired,
        repaired: and its repair.
    """
    content = read_simulator(repaired)
    engines = [make_engine(str(file)) for file in (own, other)]
    assert all(isinstance(engine, Engine) for engine in engines)
    mine, theirs = (engine.declared for engine in engines)  # type: ignore[attr-defined]
    moved = {
        name: mine[name].value + value - theirs[name].value
        for name, value in content["parameters"].items()
    }
    parameters = {n: min(max(v, mine[n].lower), mine[n].upper) for n, v in moved.items()}
    return {**content, "engine": str(own), "parameters": parameters}


def beside(content: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The content with its files as a simulator file in this folder names them; nothing empty."""

    def named(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {key: named(inner) for key, inner in value.items()}
        is_file = isinstance(value, str) and value.endswith(PATHS)
        return os.path.relpath(value, folder) if is_file else value

    return {key: named(value) for key, value in content.items() if value}


def _write_factory(config: TransferConfig, car: str, arm: Arm, file: Path) -> None:
    """Writes `FILE:make`, a simulator as every script takes it, of which cars are drawn."""
    draw, given = randomised.__name__, [str(file)]
    module = randomised.__module__
    if arm.drawn == "answer":
        draw, module = repaired_with_spread.__name__, repaired_with_spread.__module__
        given += [str(config.fitted(car)), str(config.answer(car))]
    arguments = ", ".join(map(repr, given))
    text = FACTORY.format(simulator=file, name=draw, module=module, arguments=arguments)
    write_atomically(file.with_suffix(".py"), text)
