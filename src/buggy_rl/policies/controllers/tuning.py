"""Random search for a controller's numbers; each environment tries a set of its own."""

from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass, replace
from operator import attrgetter
from typing import Any, TypeVar

import torch
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase

from buggy_rl.policies.closed_loop import drive

Number = Any  # float, or Tensor of the batch's shape; OmegaConf takes no union of the two
Config = TypeVar("Config")
NARROWING = 0.4  # of the range in which the next round looks about the best so far


def within(low: float, high: float) -> dict[str, Any]:
    """Metadata of a field: the range in which `tune` looks for it."""
    return {"range": (low, high)}


@dataclass(frozen=True)
class TuningConfig:
    """Extent of a search, and what its result must keep to."""

    steps: int = 1000
    """Steps of each drive of the search."""
    rounds: int = 4
    """Rounds of the search, each nearer to the best so far."""
    lateral_limit: float = 0.15
    """RMS distance from the path that the best may have [m]; when nothing keeps to it, the one that
    strays least is taken."""
    range_limit: float = 1.0
    """Share of steps that the best may be outside what a learned simulator was trained on: what
    such a simulator says of faster drivers is worth little."""
    seed: int = 0
    """Seed of the search."""


@dataclass(frozen=True)
class Trial:
    """One set of numbers and its scores, means over the paths."""

    values: dict[str, float]
    waypoints: float
    lateral_rms: float
    out_of_range: float
    """Share of steps; 0 over engines that know all there is to know of themselves."""


def tune(
    env: EnvBase,
    paths: int,
    driver: Callable[[Config], TensorDictModuleBase],
    config: Config,
    search: TuningConfig,
) -> tuple[Config, list[Trial]]:
    """Looks for the numbers that close most waypoints without straying.

    The first round looks everywhere in the ranges, each further one about the best so far. The
    config given is the first to be tried, so what is found is never worse.

    Args:
        env: Batch [candidates * paths], each car on the path of its own index (`order: fixed`).
        paths: How many there are; every candidate drives each.
        driver: Builds the driver of a config whose numbers are tensors of the batch's shape.
        config: A dataclass with fields that have a range (`within`), also nested ones.
        search: How far to look.

    Returns:
        The best config, and all that was tried, best first.

    Raises:
        ValueError: The cars are not the same number on each path.
    """
    cars = env.batch_size.numel()
    if cars % paths:
        raise ValueError(f"{cars} cars on {paths} paths: must be a multiple, one car on each path")
    ranges = dict(_ranges(config))
    low, high = (torch.tensor([r[i] for r in ranges.values()]) for i in (0, 1))
    generator = torch.Generator().manual_seed(search.seed)
    best = torch.tensor([float(attrgetter(name)(config)) for name in ranges])
    trials: list[Trial] = []
    for turn in range(search.rounds):
        reach = (high - low) * (1.0 if turn == 0 else NARROWING**turn)
        drawn = torch.rand(cars // paths, len(ranges), generator=generator)
        centre = (low + high) / 2 if turn == 0 else best
        values = (centre + (drawn - 0.5) * reach).clamp(low, high)
        values[0] = best
        of_cars = values.repeat_interleave(paths, 0).to(env.device or "cpu").unbind(-1)
        scores = drive(
            env, driver(_with(config, dict(zip(ranges, of_cars, strict=True)))), search.steps
        )
        judged = (scores.waypoints, scores.lateral_rms, scores.out_of_range.nan_to_num(0.0))
        means = [s.reshape(-1, paths).mean(1).tolist() for s in judged]
        trials += [
            Trial(dict(zip(ranges, row, strict=True)), *came)
            for row, *came in zip(values.tolist(), *means, strict=True)
        ]
        trials.sort(key=lambda t: _rank(t, search), reverse=True)
        best = torch.tensor(list(trials[0].values.values()))
    return _with(config, trials[0].values), trials


def _rank(trial: Trial, search: TuningConfig) -> tuple[bool, bool, float]:
    within = trial.out_of_range <= search.range_limit
    kept = trial.lateral_rms <= search.lateral_limit
    if not within:
        return False, False, -trial.out_of_range
    return True, kept, trial.waypoints if kept else -trial.lateral_rms


def _ranges(config: Any, prefix: str = ""):
    for item in fields(config):
        value = getattr(config, item.name)
        if is_dataclass(value):
            yield from _ranges(value, f"{prefix}{item.name}.")
        elif "range" in item.metadata:
            yield prefix + item.name, item.metadata["range"]


def _with(config: Any, values: dict[str, Any], prefix: str = "") -> Any:
    """The config with other values by dotted name."""
    changed = {}
    for item in fields(config):
        name, value = prefix + item.name, getattr(config, item.name)
        nested = is_dataclass(value)
        changed[item.name] = _with(value, values, f"{name}.") if nested else values.get(name, value)
    return replace(config, **changed)
