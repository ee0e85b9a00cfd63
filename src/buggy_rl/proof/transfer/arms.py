"""Simulators that policies are trained in: what each is made from."""

from dataclasses import dataclass
from typing import Literal

Base = Literal["fit", "repair", "refit", "model", "car", "placebo"]
"""Simulator fitted before the change; that with the diagnosis's repair; one fitted after it;
the learned model; the changed car itself; the first with another car's repair."""
Gradient = Literal["", "before", "learned"]
"""Model whose derivatives a training follows: of the earlier drives, or of all; empty where the
simulator has its own."""


@dataclass(frozen=True)
class Arm:
    """What the policies of an arm are trained in."""

    meaning: str
    """Words of the page."""
    base: Base
    gradient: Gradient = "before"
    drawn: Literal["", "fit", "answer"] = ""
    """Whether every environment has parameters of its own: by ranges about those of the fit, or
    from the intervals of fit and answer."""
    start: str = ""
    """Arm whose policies of the same car and seed a training begins with."""


ARMS: dict[str, Arm] = {
    "as_given": Arm("a single track fitted to the car before the change", "fit"),
    "repaired": Arm("as given with the repair of the diagnosis, all its layers", "repair"),
    "refitted": Arm(
        "a single track fitted to the two minutes after the change", "refit", "learned"
    ),
    "learned": Arm("a model learned from these two minutes and the drives before", "model", ""),
    "randomised": Arm("as given, every environment with other parameters", "fit", drawn="fit"),
    "repaired_randomised": Arm(
        "repaired, parameters and numbers drawn within their intervals", "repair", drawn="answer"
    ),
    "truth": Arm("the changed car itself", "car", "learned"),
    "placebo": Arm("as given with the repair of another car", "placebo"),
    "continued": Arm(
        "repaired, beginning with the policy of as_given, a tenth of the steps",
        "repair",
        start="as_given",
    ),
}
"""A further arm is an entry here."""
