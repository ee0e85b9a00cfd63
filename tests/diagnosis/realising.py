"""A user's own simulator that says which effects its parameters are."""

from collections.abc import Sequence
from typing import ClassVar

import torch
from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from buggy_rl.core.parameters import Added, Parameter, Realisations, Scaled
from tests.plain_env import MASS, DeclaredCar


class RealisingCar(DeclaredCar):
    """m (dvx - vy r) = F - c vx - ...: a viscous drag is more of c; less grip is less of mu."""

    substeps = 2
    declared: ClassVar[dict[str, Parameter]] = {
        **DeclaredCar.declared,
        "stiffness": Parameter("stiffness", 6.0, 1.0, 40.0, "1/rad", "Of tanh(B alpha)."),
    }
    realises: ClassVar[Realisations] = {
        "viscous_drag": [Added("motor_damping", "rate", MASS)],
        "tire_grip": [Scaled("grip", "grip"), Scaled("stiffness", "grip", -1.0)],
    }

    def with_parameters(self, values: TensorDictBase) -> "RealisingCar":
        numbers = {name: value.double() for name, value in values.items()}
        return RealisingCar(values.batch_size, self.device or "cpu", {**self.numbers, **numbers})


def make(batch_size: int | Sequence[int], device: torch.device | str = "cpu") -> EnvBase:
    """That many cars."""
    return RealisingCar(batch_size, device)
