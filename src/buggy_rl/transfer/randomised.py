"""Domain randomisation (Tobin et al., 2017; Peng et al., 2018): physics drawn for each environment.

Each environment of a batch keeps its parameters, also over new episodes.
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs import EnvBase

from buggy_rl.engines.base import Engine
from buggy_rl.task.env import make_simulator


class Spread(NamedTuple):
    """Parameters that one number is drawn for, evenly."""

    names: tuple[str, ...]
    low: float
    high: float
    added: bool
    """Whether the number is added, in the parameter's unit; else they are multiplied by it."""
    why: str


SPREADS = (
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


def randomised(simulator: str, batch_size: int | Sequence[int], device: str = "cpu") -> EnvBase:
    """A simulator as `make_simulator` makes it, with parameters drawn for each environment.

    p' = f p or p + a, with f, a evenly from `SPREADS`, then kept within the parameter's range.
    PyTorch's global generator draws them: the seed fixes them.

    Raises:
        ValueError: The simulator has none of the parameters.
    """
    engine = make_simulator(simulator, batch_size, device)
    if not isinstance(engine, Engine) or not any(n in engine.values for s in SPREADS for n in s[0]):
        raise ValueError(f"{simulator} has no parameters that could be drawn: use MuJoCo's")
    return engine.with_parameters(TensorDict(drawn(engine), engine.batch_size))


def drawn(engine: Engine) -> dict[str, Tensor]:
    """Parameter name -> values [*batch] of every parameter that the engine has of `SPREADS`."""
    values: dict[str, Tensor] = {}
    for spread in SPREADS:
        number = spread.low + (spread.high - spread.low) * torch.rand(engine.batch_size)
        for name in spread.names:
            if name in engine.values:
                value = values.get(name, engine.values[name].cpu().expand(engine.batch_size))
                values[name] = value + number if spread.added else value * number
    ranges = engine.declared
    return {n: v.clamp(ranges[n].lower, ranges[n].upper) for n, v in values.items()}
