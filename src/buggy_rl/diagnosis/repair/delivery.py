"""What is delivered: the set of effects whose repair predicts what was held out.

A repair is validated as it is delivered, commands as they are stamped, and none is delivered that
makes rollouts of held-out data worse.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from torch import Tensor

from buggy_rl.diagnosis.repair.validation import SAID, Errors
from buggy_rl.diagnosis.search.candidate import Candidate
from buggy_rl.diagnosis.search.result import SearchResult
from buggy_rl.estimation.evidence import misfit
from buggy_rl.estimation.hypothesis import Hypothesis

SLACK = 0.02  # [-] share by which a median distance may seem larger without being worse; chosen
OTHER = "other"  # name of the second candidate's errors


@dataclass(frozen=True)
class Repair:
    """What `repaired.yaml` has beyond the simulator as given."""

    values: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Effect, or `parameter:NAME` -> number -> value, about the simulator as given."""
    median: Mapping[float, float] = field(default_factory=dict)
    """Horizon [s] -> median distance [m] of rollouts of the file on all that it was fitted to."""
    refused: tuple[str, ...] = ()
    """Effects that were fitted and would make held-out rollouts worse."""
    worse: tuple[float, float] | None = None
    """[m] median distance after `SAID` without and with them, where they were refused."""

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of what is in it."""
        return tuple(self.values)

    def lines(self, named: tuple[str, ...]) -> list[str]:
        """What a reader of the names could not guess of the file.

        Args:
            named: Effects that the answer names.
        """
        if self.refused:
            distance = ""
            if self.worse is not None:
                without, given = (f"{1000 * of:.0f} mm" for of in self.worse)
                distance = f" (median position error {without} without, {given} with it)"
            return [
                f"repaired.yaml is the simulator as given: {', '.join(self.refused)} would make "
                f"held-out rollouts worse{distance}."
            ]
        own = [name for name in self.effects if not name.startswith("parameter:")]
        if set(own) <= set(named):
            return []
        return [
            f"repaired.yaml has {', '.join(own)}: the set that predicts held-out rollouts best, "
            "whether or not each is what the car has."
        ]

    def to_dict(self) -> dict[str, Any]:
        """As `diagnosis.json` has it."""
        return {
            "values": {effect: dict(own) for effect, own in self.values.items()},
            "position_median": {f"{horizon:g} s": of for horizon, of in self.median.items()},
            "refused": list(self.refused),
        }


def repair_candidates(found: SearchResult) -> list[Candidate]:
    """Sets whose repair is validated, the preferred one first; the empty one is none."""
    first, second = found.best, found.predictive
    if found.posterior.says == "unknown":
        first, second = second, first
    chosen = [first] if found.posterior.says == "nothing" else [first, second]
    return [c for i, c in enumerate(chosen) if c not in chosen[:i]]


def chosen(errors: Mapping[str, Errors], unknown: bool) -> str:
    """Name of the errors of the set that is delivered; `before` where each would be worse.

    Args:
        errors: `before`, `after` of the preferred set, and maybe `OTHER`.
        unknown: Whether what predicts best is asked for, rather than what is most probable.
    """
    before = errors["before"]
    names = [n for n in ("after", OTHER) if n in errors and not is_worse(errors[n], before)]
    if unknown:
        names.sort(key=lambda name: misfit(errors[name].square, before.square))
    return names[0] if names else "before"


def is_worse(errors: Errors, before: Errors) -> bool:
    """Whether held-out rollouts are farther off, by misfit or by the median distance."""
    given: Tensor = before.square
    if misfit(errors.square, given) > misfit(given, given):
        return True
    then, now = (e.median.get(SAID, 0.0) for e in (before, errors))
    return now > (1 + SLACK) * then


def as_file(best: Hypothesis, errors: Errors) -> Repair:
    """What a hypothesis about the simulator as given puts into its file."""
    return Repair(best.values(), errors.median)
