"""A repaired simulator whose environments differ by what fit and diagnosis left open."""

import json
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
import yaml
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs import EnvBase

from buggy_rl.core.parameters import Change, Scaled
from buggy_rl.effects.base import Effect
from buggy_rl.proof.transfer.parameter_posterior import WIDER, scaled_correction
from buggy_rl.simulators import read_simulator
from buggy_rl.simulators.base import Engine
from buggy_rl.task.env import effects_for, make_simulator, with_effects

Named = Mapping[str, Mapping[str, Mapping[str, float]]]
"""Effect -> number -> `value`, and `low` and `high` of its interval."""
OWN = "parameter:"  # begins the name of a parameter of the simulator's own in an answer


def repaired_with_spread(
    simulator: str | Path,
    fitted: str | Path,
    answer: str | Path,
    batch_size: int | Sequence[int],
    device: str = "cpu",
) -> EnvBase:
    """A repaired simulator with numbers drawn for each environment.

    Numbers of named effects and terms: evenly from the answer's 95 % intervals, also where the
    repair has them as parameters of its own. Other parameters: their repaired value and twice the
    distance of a draw from the fit's 95 % interval to its best guess, within their range; but those
    of which the fit warns stay, since it is right on a ridge of several of them at once and draws
    are independent. A learned correction: 0 to twice its strength. PyTorch's global generator
    draws: the seed fixes all.

    Args:
        simulator: The repaired one, or a surrogate over it: an engine with effects over it.
        fitted: File of the fit that was repaired.
        answer: `diagnosis.json`.
        batch_size: Number of environments or a shape.
        device: Where the state lives.

    Raises:
        ValueError: A file cannot be read, or the simulator is no `Engine`.
    """
    content, fit = read_simulator(Path(simulator)), yaml.safe_load(Path(fitted).read_text())
    named = {e["name"]: e["parameters"] for e in json.loads(Path(answer).read_text())["effects"]}
    repaired = content["parameters"]
    engine = make_simulator(
        content["engine"], batch_size, device, repaired or None, **content["options"]
    )
    if not isinstance(engine, Engine):
        raise ValueError(f"{simulator} is a {type(engine).__name__}: its engine must be of ours")
    values = _about_repaired(engine, fit)
    _draw_named(values, engine, named, repaired)
    engine = engine.with_parameters(_within_range(values, engine))
    effects = effects_for(engine, content["effects"])
    return with_effects(engine, [_drawn_effect(e, named, engine.batch_size) for e in effects])


def _about_repaired(engine: Engine, fit: Mapping[str, Any]) -> dict[str, Tensor]:
    """Fitted parameters [*batch], by as much about their repaired values as the fit left open."""
    return {
        name: engine.values[name].cpu()
        + WIDER * (_between(interval, engine.batch_size) - fit["parameters"][name])
        for name, interval in sorted(fit["_fit"].items())
        if not interval.get("warnings")
    }


def _draw_named(
    values: dict[str, Tensor], engine: Engine, named: Named, repaired: Collection[str]
) -> None:
    """Draws what the answer names of the repair's parameters, in `values`."""
    size = engine.batch_size
    for effect, numbers in named.items():
        if (own := effect.removeprefix(OWN)) != effect and own in repaired:
            values[own] = _between(numbers[own], size)
        for change in engine.realises.get(effect, ()):
            name = change.parameter
            if name in repaired and change.number in numbers:
                value = values.get(name, engine.values[name].cpu().expand(size))
                values[name] = _moved(change, value, numbers[change.number], size)


def _within_range(values: Mapping[str, Tensor], engine: Engine) -> TensorDict:
    ranges = engine.declared
    kept = {n: v.clamp(ranges[n].lower, ranges[n].upper) for n, v in values.items()}
    return TensorDict(kept, engine.batch_size)


def _moved(
    change: Change, value: Tensor, number: Mapping[str, float], batch_size: torch.Size
) -> Tensor:
    """A parameter whose change is by a drawn number in place of the fitted one."""
    drawn, best = _between(number, batch_size), number["value"]
    return change.changed(value, drawn / best if isinstance(change, Scaled) else drawn - best)


def _drawn_effect(effect: Effect, named: Named, batch_size: torch.Size) -> Effect:
    if effect.name not in named:
        return scaled_correction(effect, batch_size)
    drawn = {name: _between(number, batch_size) for name, number in named[effect.name].items()}
    return effect.with_parameters(TensorDict(drawn, batch_size))


def _between(interval: Mapping[str, float], batch_size: torch.Size) -> Tensor:
    """Even draws from an interval; on the CPU, so that a seed gives the same on every device."""
    return interval["low"] + (interval["high"] - interval["low"]) * torch.rand(batch_size)
