"""What a reference car is beside its parameters."""

from dataclasses import dataclass, field

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

    @property
    def usual(self) -> bool:
        """Whether it is the buggy with a one-way throttle."""
        return self == Build()
