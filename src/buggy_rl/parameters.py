"""A physical parameter that a simulator declares, so that it can be fitted or found wrong."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Parameter:
    """One number of a simulator, with the range in which it makes sense."""

    name: str
    value: float
    lower: float
    upper: float
    unit: str
    """SI unit, `-` for a ratio."""
    meaning: str
    """One sentence in plain words."""

    def __post_init__(self) -> None:
        if not self.lower <= self.value <= self.upper:
            raise ValueError(
                f"parameter {self.name!r} is {self.value} {self.unit}, outside its range "
                f"[{self.lower}, {self.upper}]: correct the value or widen the range"
            )
