"""A fitted simulator whose environments have parameters drawn from the intervals of its fit.

Drives in a room do not determine all parameters, such as front against rear grip or the shape of
the tyre curve, and a policy trained at the best estimate drives at the limit of that one car. Each
environment of a batch keeps parameters of its own, uniform over twice the fit's 95 % intervals:
an interval accounts for noise, not for physics that no parameter of the simulator stands for. The
strength of a learned correction is drawn from 0 to twice that of the repair.
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


def posterior(
    simulator: str | Path,
    batch_size: int | Sequence[int],
    device: str = "cpu",
    tuned: Mapping[str, float] | None = None,
) -> EnvBase:
    """A fitted simulator with parameters drawn for each environment.

    p = best + 2 (drawn - best), drawn uniformly from the 95 % interval and clamped to the range.
    Named effects stay as they are. Parameters are drawn independently, so correlated ones spread
    more than their joint posterior. PyTorch's global generator draws them: the seed fixes them.

    Args:
        simulator: A file written by a fit, or one that puts effects over such a file.
        batch_size: Number of environments or a shape.
        device: Where the state lives.
        tuned: Parameters with known values, which are not drawn.

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
        engine = posterior(content["engine"], batch_size, device, known)
    else:
        engine = make_simulator(file, batch_size, device, known)
        assert isinstance(engine, Engine)
        intervals = {name: fitted[name] for name in fitted.keys() - known}
        engine = engine.with_parameters(_drawn(engine, intervals))
    effects = [_scaled(effect, engine.batch_size) for effect in make_effects(content["effects"])]
    return with_effects(engine, effects)


def _scaled(effect: Effect, batch_size: torch.Size) -> Effect:
    if not isinstance(effect, ResidualAcceleration):
        return effect
    strength = 2.0 * effect.values["strength"].cpu() * torch.rand(batch_size)
    return effect.with_parameters(TensorDict({"strength": strength}, batch_size))


def _drawn(engine: Engine, intervals: Mapping[str, Mapping[str, float]]) -> TensorDict:
    values = {}
    for name, interval in sorted(intervals.items()):
        bounds, best = engine.declared[name], engine.values[name]
        width = interval["high"] - interval["low"]
        # Drawn on the CPU: a seed gives the same cars on every device.
        drawn = interval["low"] + width * torch.rand(engine.batch_size).to(best.device)
        values[name] = (best + WIDER * (drawn - best)).clamp(bounds.lower, bounds.upper)
    return TensorDict(values, engine.batch_size)
