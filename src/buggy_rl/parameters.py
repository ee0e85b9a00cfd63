"""A physical parameter that a simulator declares, so that it can be fitted or found wrong."""

from dataclasses import dataclass

ROUNDING = 1e-9  # of a bound: a file says 0.1218 where 1.4 x 0.087 is 0.12179999999999998


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
        slack = ROUNDING * max(abs(self.lower), abs(self.upper))
        if not self.lower - slack <= self.value <= self.upper + slack:
            raise ValueError(
                f"parameter {self.name!r} is {self.value} {self.unit}, outside its range "
                f"[{self.lower:.6g}, {self.upper:.6g}]: correct the value or widen the range"
            )
        # On the bound, not beyond it: what fits from here wants a start within the range.
        object.__setattr__(self, "value", min(max(self.value, self.lower), self.upper))
