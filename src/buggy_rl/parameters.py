"""A physical parameter that a simulator declares, so that it can be fitted or diagnosed."""

from dataclasses import dataclass

ROUNDING = 1e-9  # [-] relative slack of a bound: decimal values in files, 0.1218 for 1.4 x 0.087


@dataclass(frozen=True)
class Parameter:
    """One parameter of a simulator and its range."""

    name: str
    value: float
    lower: float
    upper: float
    unit: str
    """SI unit, `-` for a ratio."""
    meaning: str
    """One sentence."""

    def __post_init__(self) -> None:
        slack = ROUNDING * max(abs(self.lower), abs(self.upper))
        if not self.lower - slack <= self.value <= self.upper + slack:
            raise ValueError(
                f"parameter {self.name!r} is {self.value} {self.unit}, outside its range "
                f"[{self.lower:.6g}, {self.upper:.6g}]: correct the value, name the car (car=...) "
                f"or widen the range (ranges: {{{self.name}: [lower, upper]}})"
            )
        # Clamped to the bound: a fit that starts here needs a start within the range.
        object.__setattr__(self, "value", min(max(self.value, self.lower), self.upper))
