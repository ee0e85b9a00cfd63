"""What a reference car is beside its parameters."""

from dataclasses import astuple, dataclass, field, fields
from typing import Any

from torch import Tensor

from buggy_rl.longitudinal import ONE_WAY, LongitudinalCommand
from buggy_rl.similarity import Similarity
from buggy_rl.vehicle import VehicleDimensions


@dataclass(frozen=True)
class Build:
    """Size and command of a car; those of the buggy by default."""

    dimensions: VehicleDimensions = field(default_factory=VehicleDimensions)
    similarity: Similarity = field(default_factory=Similarity)
    """Ratios to the buggy, by which the constants of the parts are scaled."""
    command: LongitudinalCommand = ONE_WAY
    """What its first command is."""

    @property
    def parts(self) -> tuple[VehicleDimensions, Similarity, LongitudinalCommand]:
        """Its fields, in their order."""
        return self.dimensions, self.similarity, self.command

    def numbers(self, like: Tensor) -> Tensor:
        """Dimensions and ratios in one tensor [S] of the type of another."""
        return like.new_tensor((*astuple(self.dimensions), *astuple(self.similarity)))

    @classmethod
    def of_numbers(cls, numbers: Tensor, command: LongitudinalCommand) -> "Build":
        """The inverse of `numbers`, of tensors."""
        own: list[Any] = list(numbers.unbind())
        count = len(fields(VehicleDimensions))
        return cls(VehicleDimensions(*own[:count]), Similarity(*own[count:]), command)

    @property
    def usual(self) -> bool:
        """Whether it is the buggy with a one-way throttle."""
        return self == Build()
