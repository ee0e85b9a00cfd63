"""A user's own simulator that is slow: the reference car in float64 with twenty times the steps."""

import torch
from tensordict import TensorDictBase
from torch import Tensor

from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.simulators.reference import ReferenceEngine
from buggy_rl.simulators.reference.engine import SUBSTEP

TIMES = 20  # as many steps as the reference car


class SlowCar(ReferenceEngine):
    """The reference car, uncompiled, in float64 inside and float32 outside."""

    def _advance(self, state: TensorDictBase, action: Tensor) -> dict[str, Tensor]:
        wide = state.apply(lambda x: x.double() if x.is_floating_point() else x)
        assert wide is not None
        after = super()._advance(wide, action.double())
        return {name: value.to(state[name].dtype) for name, value in after.items()}


def make(batch_size: int, device: torch.device | str = "cpu") -> SlowCar:
    """That many cars."""
    return SlowCar(batch_size, device, substep=SUBSTEP / TIMES)


def make_own(batch_size: int, device: torch.device | str = "cpu") -> SlowCar:
    """The same in eight steps a control period."""
    return SlowCar(batch_size, device, substep=CONTROL_PERIOD / 8)
