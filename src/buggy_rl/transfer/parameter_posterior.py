"""A fitted simulator whose cars differ by what its fit could not decide.

Drives in a room leave some parameters open: grip in front from grip behind, the shape of a tyre's
curve. A policy that is trained at the single best guess learns to drive at the limit of that one
car. Here each car of a batch keeps a guess of its own, evenly from twice the fit's 95 % intervals:
narrow where the drives were telling, wide where they were not, and twice because an interval knows
of noise and nothing of what no parameter of the simulator stands for. A learned correction is such
a guess as well: of it a car feels anything from nothing to twice of what the repair put in.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
import yaml
from tensordict import TensorDict
from torchrl.envs import EnvBase

from buggy_rl.effects import make_effects
from buggy_rl.effects.base import Effect
from buggy_rl.effects.residual import ResidualAcceleration
from buggy_rl.engines import read_simulator
from buggy_rl.engines.base import Engine
from buggy_rl.task.env import make_simulator, with_effects

WIDER = 2.0  # than the fit's 95 % intervals, from its best guess


def undecided(
    simulator: str | Path,
    batch_size: int | Sequence[int],
    device: str = "cpu",
    tuned: Mapping[str, float] | None = None,
) -> EnvBase:
    """Cars of a fitted simulator, each as likely as the others.

    Physics that has a name stays over it as it is. Parameters are drawn one by one: two that a fit
    can tell only together differ by more than it leaves open. They come from PyTorch's global
    generator, so that a run's seed fixes its cars.

    Args:
        simulator: A file written by a fit, or one that puts effects over such a file.
        batch_size: Number of cars or a shape.
        device: Where the state lives.
        tuned: Parameters that are known otherwise, and not drawn.

    Raises:
        ValueError: No fit has written it, or a file cannot be read.
    """
    file = Path(simulator)
    if file.suffix not in (".yaml", ".yml"):
        raise ValueError(
            f"{simulator} has no intervals to draw from: use a file that scripts/fit_mujoco.py has "
            "written (or, in scripts/transfer.py, undecided=false)"
        )
    content, known = read_simulator(file), dict(tuned or {})
    fitted = yaml.safe_load(file.read_text()).get("_fit")
    if fitted is None:
        known = {**content["parameters"], **known}
        engine = undecided(content["engine"], batch_size, device, known)
    else:
        engine = make_simulator(file, batch_size, device, known)
        assert isinstance(engine, Engine)
        intervals = {name: fitted[name] for name in fitted.keys() - known}
        engine = engine.with_parameters(_drawn(engine, intervals))
    effects = [_felt(effect, engine.batch_size) for effect in make_effects(content["effects"])]
    return with_effects(engine, effects)


def _felt(effect: Effect, batch_size: torch.Size) -> Effect:
    if not isinstance(effect, ResidualAcceleration):
        return effect
    strength = 2.0 * effect.values["strength"] * torch.rand(batch_size)
    return effect.with_parameters(TensorDict({"strength": strength}, batch_size))


def _drawn(engine: Engine, intervals: Mapping[str, Mapping[str, float]]) -> TensorDict:
    values = {}
    for name, interval in sorted(intervals.items()):
        bounds, best = engine.declared[name], engine.values[name]
        width = interval["high"] - interval["low"]
        drawn = interval["low"] + width * torch.rand(engine.batch_size)
        values[name] = (best + WIDER * (drawn - best)).clamp(bounds.lower, bounds.upper)
    return TensorDict(values, engine.batch_size)
