"""From steering command to road-wheel angle and back, of the two bicycle engines."""

from collections.abc import Mapping

import torch
from torch import Tensor

LEFT_RIGHT_BLEND = 30.0  # [-] steepness of the blend from right to left; dart_dynamic_models.py


def road_wheel_angle(command: Tensor, values: Mapping[str, Tensor]) -> Tensor:
    """Road-wheel angle [*] rad of a steering command [*].

    s = command + offset, w = (1 + tanh(30 s)) / 2,
    delta = w a_left tanh(b_left s) + (1 - w) a_right tanh(b_right s).

    Source: DART, Lyons et al., dart_dynamic_models.py.
    """
    s = command + values["steering_offset"]
    to_left = 0.5 * (1 + torch.tanh(LEFT_RIGHT_BLEND * s))
    left = values["left_angle"] * torch.tanh(values["left_steepness"] * s)
    right = values["right_angle"] * torch.tanh(values["right_steepness"] * s)
    return to_left * left + (1 - to_left) * right


def steering_command(angle: Tensor, values: Mapping[str, Tensor]) -> Tensor:
    """Steering command [*] in [-1, 1] closest to a road-wheel angle [*] rad; inverse of the map."""
    left = angle > 0
    reach = torch.where(left, values["left_angle"], values["right_angle"])
    steepness = torch.where(left, values["left_steepness"], values["right_steepness"])
    share = (angle / reach).clamp(-0.999, 0.999)  # atanh(1) is infinite
    return (torch.atanh(share) / steepness - values["steering_offset"]).clamp(-1.0, 1.0)
