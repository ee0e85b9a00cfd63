"""A controller of the buggy that drives a similar car of another size."""

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from buggy_rl import keys
from buggy_rl.car_file import load_car
from buggy_rl.similarity import Similarity


class AtScale(TensorDictModuleBase):
    """Shows a controller the waypoints and velocities of the similar buggy; commands are the same.

    x' = x / L,  v' = v / S,  r' = r L / S, with the ratios L of lengths and S of speeds: a
    controller's distances, speeds and gains stay those of the buggy. Its times scale with L / S.

    Args:
        controller: That reads `waypoints` and `velocity`, and writes `action`.
        scale: Ratios of the car to the buggy.
    """

    def __init__(self, controller: TensorDictModuleBase, scale: Similarity) -> None:
        super().__init__()
        self.in_keys, self.out_keys = [keys.WAYPOINTS, keys.VELOCITY], [keys.ACTION]
        self.controller, self.scale = controller, scale

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes `action` [*, 2] for `waypoints` [*, W, 2] and `velocity` [*, 3]."""
        velocity = tensordict[keys.VELOCITY]
        units = [self.scale.of(unit) for unit in ("m/s", "m/s", "rad/s")]
        seen = tensordict.select(keys.WAYPOINTS, keys.VELOCITY)
        seen[keys.WAYPOINTS] = tensordict[keys.WAYPOINTS] / self.scale.length
        seen[keys.VELOCITY] = velocity / torch.tensor(units, device=velocity.device)
        tensordict[keys.ACTION] = self.controller(seen)[keys.ACTION]
        return tensordict


def for_car(controller: TensorDictModuleBase, car: str) -> TensorDictModuleBase:
    """A controller for a car by name or file; itself for the buggy, whose name is empty."""
    return AtScale(controller, load_car(car).similarity) if car else controller
