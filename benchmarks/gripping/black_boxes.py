"""Plants as a user's own simulators: pose, velocity and action, and nothing declared."""

import torch
from benchmarks.gripping.plants import Closed, maker

Device = torch.device | str


def reference(batch_size: int, device: Device = "cpu") -> Closed:
    """The reference car: two tracks, combined slip, load transfer."""
    return Closed(maker("reference")(batch_size))


def mujoco(batch_size: int, device: Device = "cpu") -> Closed:
    """The MuJoCo car with explicit tyre forces."""
    return Closed(maker("mujoco")(batch_size))


def contact(batch_size: int, device: Device = "cpu") -> Closed:
    """The MuJoCo car with MuJoCo's contacts as tyres."""
    return Closed(maker("contact")(batch_size))


def commonroad(batch_size: int, device: Device = "cpu") -> Closed:
    """The multi-body car of CommonRoad."""
    return Closed(maker("commonroad")(batch_size))


BLACK_BOXES = {box.__name__: box for box in (reference, mujoco, contact, commonroad)}
