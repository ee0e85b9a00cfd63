"""How far a diagnosis is, in environment steps, and how long it will take."""

import time
from collections.abc import Callable
from dataclasses import dataclass

from buggy_rl.diagnosis.plan import Plan, Stage

SETTLED = 0.1  # [-] of the plan done, from which its own speed counts fully


@dataclass(frozen=True)
class Reading:
    """What a meter shows."""

    done: int
    """Environment steps."""
    planned: int
    """Environment steps; a search may end before."""
    left: float
    """Time left [s]."""


class Meter:
    """Counts rollouts against a plan.

    The time left is what the plan has left, times how much longer it took so far than planned. A
    stage that takes more than planned leaves to the later ones what was planned for them.

    Args:
        show: Told after every rollout.
        says: Told what is being done.
    """

    def __init__(self, show: Callable[[Reading], None], says: Callable[[str], None]) -> None:
        self._show = show
        self.says = says
        self._plan: Plan | None = None
        self._ends: tuple[float, int] = (0.0, 0)  # of the stage, by the plan: seconds and steps
        self._begun = self._due = self._rolled = 0.0
        self._steps = self._passed = 0  # rolled out, and of the plan, that skips what is not needed

    def begin(self, plan: Plan, stage: Stage = "prepare") -> None:
        """Takes a plan: from the first seconds on the time left is shown."""
        self._plan, self._begun, self._rolled = plan, time.perf_counter(), 0.0
        self.stage(stage)

    def stage(self, stage: Stage) -> None:
        """What was planned before this stage is done, or was not needed."""
        if self._plan is not None:
            self._due, self._passed = self._plan.before(stage)
            self._ends = self._plan.until(stage)
            self._tell(self._plan)

    def rolled(self, environments: int, rows: int) -> None:
        """A rollout has ended."""
        if self._plan is not None:
            self._steps += environments * rows
            self._passed += environments * rows
            expected = self._plan.cost.seconds(environments, rows)
            self._due, self._rolled = self._due + expected, self._rolled + expected
            self._tell(self._plan)

    def _tell(self, plan: Plan) -> None:
        slower = (time.perf_counter() - self._begun) / self._rolled if self._rolled else 1.0
        known = min(1.0, self._rolled / plan.seconds / SETTLED)
        seconds, steps = self._ends
        left = (plan.seconds - min(self._due, seconds)) * (known * slower + 1 - known)
        self._show(Reading(self._steps, self._steps + plan.steps - min(self._passed, steps), left))
