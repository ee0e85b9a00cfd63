"""A fitted simulator whose environments have parameters drawn from the intervals of its fit.

Drives in a room do not determine all parameters, such as front against rear grip or the shape of
the tyre curve, and a policy trained at the best estimate drives at the limit of that one car. Each
environment of a batch keeps parameters of its own, uniform over twice the fit's 95 % intervals:
an interval accounts for noise, not for physics that no parameter of the simulator stands for. The
strength of a learned correction is drawn from 0 to twice that of the repair.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch
import yaml
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs import EnvBase

from buggy_rl.effects.base import Effect
from buggy_rl.effects.residual import ResidualAcceleration
from buggy_rl.simulators import read_simulator
from buggy_rl.simulators.base import Engine
from buggy_rl.task.env import effects_for, make_simulator, with_effects

WIDER = 2.0  # than the fit's 95 % intervals, from its best guess


def fitted_with_spread(
    simulator: str | Path,
    batch_size: int | Sequence[int],
    device: str = "cpu",
    tuned: Mapping[str, float] | None = None,
    **options: Any,
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
        options: Further arguments of the engine's class; those of the file that names the fitted
            one, such as a finer step, stand before its own.

    Raises:
        ValueError: No fit has written it, or a file cannot be read.
    """
    file = Path(simulator)
    if file.suffix not in (".yaml", ".yml"):
        raise ValueError(
            f"{simulator} has no intervals to draw from: use a file that scripts/fit_mujoco.py has "
            "written"
        )
    content, known = read_simulator(file), dict(tuned or {})
    options = {**content["options"], **options}
    fitted = yaml.safe_load(file.read_text()).get("_fit")
    parameters = {**content["parameters"], **known}
    if fitted is None:
        engine = fitted_with_spread(content["engine"], batch_size, device, parameters, **options)
    else:
        engine = make_simulator(content["engine"], batch_size, device, parameters, **options)
        assert isinstance(engine, Engine)
        intervals = {name: fitted[name] for name in fitted.keys() - known}
        engine = engine.with_parameters(_drawn(engine, intervals))
    effects = effects_for(engine, content["effects"])
    return with_effects(
        engine, [scaled_correction(effect, engine.batch_size) for effect in effects]
    )


def scaled_correction(effect: Effect, batch_size: torch.Size) -> Effect:
    """A learned correction with a strength of 0 to twice its own, drawn; others as they are."""
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


class Spread(NamedTuple):
    """Parameters that one number is drawn for, evenly."""

    names: tuple[str, ...]
    low: float
    high: float
    added: bool
    """Whether the number is added, in the parameter's unit; else they are multiplied by it."""
    why: str


MUJOCO = (
    Spread(("mass", "yaw_inertia"), 0.75, 1.25, False, "a battery, a camera, a lidar more or less"),
    Spread(("grip_front", "grip_rear"), 0.7, 1.1, False, "one floor for all wheels: dust, tiles"),
    Spread(("grip_front",), 0.9, 1.1, False, "tyres do not wear alike"),
    Spread(
        ("cornering_stiffness_front", "cornering_stiffness_rear"), 0.7, 1.3, False, "other rubber"
    ),
    Spread(("tyre_shape",), 0.0, 0.4, True, "drives in a room hardly tell how a tyre slides"),
    Spread(("steering_left", "steering_right"), 0.85, 1.15, False, "half a hole of a servo horn"),
    Spread(("steering_offset",), -0.03, 0.03, True, "a few clicks of trim, 1.7 degrees"),
    Spread(("steering_lag",), 0.0, 0.05, True, "a servo at low voltage takes twice its time"),
    Spread(("steering_dead_time",), 0.0, 0.08, True, "two to four frames of a slow radio"),
    Spread(("throttle_dead_time",), 0.0, 0.08, True, "likewise"),
    Spread(("drive_force",), 0.75, 1.2, False, "an empty battery, a full one"),
    Spread(("drive_speed_loss",), 0.8, 1.25, False, "another winding"),
    Spread(("rolling_resistance", "viscous_drag"), 0.7, 1.3, False, "carpet, bearings, grease"),
)
SINGLE_TRACK = (
    Spread(("mass", "yaw_inertia"), 0.75, 1.25, False, "this and all others: as of MuJoCo"),
    Spread(("front_grip", "rear_grip"), 0.7, 1.1, False, "one floor under both axles"),
    Spread(("front_grip",), 0.9, 1.1, False, "tyres do not wear alike"),
    Spread(("front_stiffness", "rear_stiffness"), 0.7, 1.3, False, "other rubber"),
    Spread(("front_shape", "rear_shape"), 0.0, 0.4, True, "how a tyre slides"),
    Spread(("left_angle", "right_angle"), 0.85, 1.15, False, "half a hole of a servo horn"),
    Spread(("steering_offset",), -0.08, 0.08, True, "in command: 1.7 degrees of 21"),
    Spread(("steering_lag",), 0.0, 0.05, True, "a servo at low voltage"),
    Spread(("steering_dead_time",), 0.0, 0.08, True, "two to four frames of a slow radio"),
    Spread(("throttle_dead_time",), 0.0, 0.08, True, "likewise"),
    Spread(("drive_force",), 0.75, 1.2, False, "an empty battery, a full one"),
    Spread(("drive_force_loss",), 0.8, 1.25, False, "another winding"),
    Spread(("dry_friction", "viscous_friction"), 0.7, 1.3, False, "carpet, bearings, grease"),
)
SPREADS = {"mujoco": MUJOCO, "single_track": SINGLE_TRACK}
"""Engine -> what is drawn of its parameters."""


def randomised(simulator: str, batch_size: int | Sequence[int], device: str = "cpu") -> EnvBase:
    """A simulator as `make_simulator` makes it, with parameters drawn for each environment.

    p' = f p or p + a, with f, a evenly from `SPREADS`, then kept within the parameter's range.
    PyTorch's global generator draws them: the seed fixes them.

    Raises:
        ValueError: No entry of `SPREADS` has parameters of the simulator alone.
    """
    engine = make_simulator(simulator, batch_size, device)
    spreads = _spreads_of(engine) if isinstance(engine, Engine) else None
    if spreads is None or not isinstance(engine, Engine):
        raise ValueError(
            f"{simulator} has no parameters that could be drawn: use one of {', '.join(SPREADS)} "
            "without effects, or a surrogate over it"
        )
    return engine.with_parameters(TensorDict(drawn_parameters(engine, spreads), engine.batch_size))


def _spreads_of(engine: Engine) -> Sequence[Spread] | None:
    """The entry of `SPREADS` of which an engine has all parameters."""
    for spreads in SPREADS.values():
        if all(name in engine.values for spread in spreads for name in spread.names):
            return spreads
    return None


def drawn_parameters(engine: Engine, spreads: Sequence[Spread]) -> dict[str, Tensor]:
    """Parameter name -> values [*batch] of every parameter in `spreads`."""
    values: dict[str, Tensor] = {}
    for spread in spreads:
        number = spread.low + (spread.high - spread.low) * torch.rand(engine.batch_size)
        for name in spread.names:
            value = values.get(name, engine.values[name].cpu().expand(engine.batch_size))
            values[name] = value + number if spread.added else value * number
    ranges = engine.declared
    return {n: v.clamp(ranges[n].lower, ranges[n].upper) for n, v in values.items()}
