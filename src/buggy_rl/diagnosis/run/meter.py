"""How far a diagnosis is, in environment steps, and how long it will take."""

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

from buggy_rl.diagnosis.run.plan import Part, Plan, Stage
from buggy_rl.jobs.bar import tqdm

SETTLED = 0.1  # [-] of the plan done, from which its own speed counts fully
RECENT = 0.2  # [-] of the plan: the last part of it, by whose speed the rest is expected


@dataclass(frozen=True)
class MeterReading:
    """What a meter shows."""

    done: int
    """Environment steps."""
    planned: int
    """Environment steps; a search may end before."""
    left: float
    """Time left [s]."""
    spent: float = 0.0
    """Time since the plan began [s]."""

    @property
    def share(self) -> float:
        """Share of the time that has passed: steps of few environments take longer than of many."""
        whole = self.spent + self.left
        return self.spent / whole if whole else 0.0


class Meter:
    """Counts rollouts against a plan.

    The time left is what the plan has left, times how much longer its last fifth took than planned:
    other programs come and go. A stage that takes more than planned leaves to the later ones what
    was planned for them.

    Args:
        show: Told after every rollout.
        says: Told what is being done.
    """

    def __init__(self, show: Callable[[MeterReading], None], says: Callable[[str], None]) -> None:
        self._show = show
        self.says = says
        self._plan: Plan | None = None
        self._ends: tuple[float, int] = (0.0, 0)  # of the stage, by the plan: seconds and steps
        self._deadline = math.inf
        self._begun = self._due = self._rolled = 0.0
        self._steps = self._passed = 0  # rolled out, and of the plan, that skips what is not needed
        self._recent: deque[tuple[float, float]] = deque()  # time [s], and expected seconds rolled

    def begin(self, plan: Plan, stage: Stage = "prepare", deadline: float = math.inf) -> None:
        """Takes a plan: from the first seconds on the time left is shown.

        Args:
            plan: The plan.
            stage: The first.
            deadline: When the time that is allowed is up (`time.perf_counter`) [s].
        """
        self._plan, self._begun, self._rolled = plan, time.perf_counter(), 0.0
        self._deadline = deadline
        self._recent = deque([(self._begun, 0.0)])
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
            self._recent.append((time.perf_counter(), self._rolled))
            while len(self._recent) > 2 and self._rolled - self._recent[1][1] > RECENT * self._all:
                self._recent.popleft()
            self._tell(self._plan)

    def admits(self, part: Part) -> bool:
        """Whether a part, and what must follow it, are expected to end before the deadline."""
        if self._plan is None or math.isinf(self._deadline):
            return True
        needed = self.slower * self._plan.needed(part)
        return time.perf_counter() + needed <= self._deadline

    @property
    def slower(self) -> float:
        """How many times longer than planned rollouts take of late, as far as it is known."""
        if not self._rolled:
            return 1.0
        (begun, before), (now, after) = self._recent[0], self._recent[-1]
        known = min(1.0, self._rolled / self._all / SETTLED)
        return known * (now - begun) / (after - before) + 1 - known

    @property
    def _all(self) -> float:
        """Seconds of the whole plan."""
        return self._plan.seconds if self._plan is not None else 0.0

    def _tell(self, plan: Plan) -> None:
        seconds, steps = self._ends
        left = (plan.seconds - min(self._due, seconds)) * self.slower
        planned = self._steps + plan.steps - min(self._passed, steps)
        self._show(MeterReading(self._steps, planned, left, time.perf_counter() - self._begun))


FORMAT = "{elapsed} {desc}{postfix}"  # before there is a plan
PLANNED = "{elapsed} {desc} {percentage:3.0f}%|{bar}|{postfix}"


class StepBar:
    """What is being done, the share of the time that has passed, steps, and the time left."""

    def __init__(self) -> None:
        self._bar = tqdm(bar_format=FORMAT)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()

    def says(self, text: str) -> None:
        """Shows what is being done."""
        self._bar.set_description_str(text)

    def show(self, reading: MeterReading) -> None:
        """Shows how far it is."""
        self._bar.bar_format = PLANNED
        self._bar.total, self._bar.n = 1.0, reading.share
        done, planned = (tqdm.format_sizeof(n) for n in (reading.done, reading.planned))
        self._bar.set_postfix_str(f"{done}/{planned} steps, about {in_words(reading.left)} left")


def in_words(seconds: float) -> str:
    """A time to the precision of an estimate.

    >>> in_words(42.0), in_words(200.0)
    ('40 s', '3 min')
    """
    if seconds < 90:
        return f"{10 * max(1, round(seconds / 10)):.0f} s"
    return f"{seconds / 60:.0f} min"
