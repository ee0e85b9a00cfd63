"""A plan: the simulator measured, what is rolled out in which time, how much less it may be."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

from buggy_rl.diagnosis.run.budget import Budget, smaller
from buggy_rl.diagnosis.run.case import Drives
from buggy_rl.effects.terms.grammar import terms
from buggy_rl.estimation.cost import MANY, Cost, measured_cost
from buggy_rl.estimation.hypothesis import Library
from buggy_rl.estimation.residual_process import ITERATIONS, TRIED
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import HORIZONS

Stage = Literal["prepare", "search", "answer"]
Part = Literal["first_round", "round", "refitted", "longer", "terms", "experiments", "retuning"]
"""What may be left out where time is up."""
STAGES: tuple[Stage, ...] = ("prepare", "search", "answer")
FITTED = 8  # terms that are fitted in a round
GLANCE = 4  # all terms are screened on one in so many segments, the best one in so many on all
NUMBERS = 3  # free parameters of a hypothesis on average, its clock included
PLANNED_ROUNDS = 2  # about the leading set: most searches end before the last of them
USUAL = 6  # iterations after which a fit has ended, most often
MISSING = 2  # sets with the other effect of a limit that are fitted, most often
CORRECTED = 20  # rollouts in which a correction is learned from a baseline
LOOKED = 4  # rollouts in which the error is located, steps are tested and a network learns
PROVED = 10  # rollouts of half the segments in which an answer is proved, by two processes half
LEARNED = 2  # learned residuals: alone, and upon what is named
TOLD = 2  # rollouts of longer segments, likewise
TERM_ROUNDS = 2  # of screening terms and fitting the best: most often one is added, no second
SLOW_RESET = 0.2  # [-] of the time of a rollout, from which a reset is worth a word
HELD = 0.85  # [-] of the time that is allowed, which a plan may fill; its error is larger


@dataclass(frozen=True)
class Question:
    """What the size of a diagnosis depends on."""

    segments: int
    """Segments of the recordings, all that there are up to `stretches`."""
    rows: int
    """Steps of one."""
    trials: int
    """Effects in each of their directions."""
    baseline: int = 0
    """Segments of the baseline."""
    longer: int = 0
    """Segments of 3 s."""
    limits: int = 0
    """Effects of the library that another of its effects becomes in a limit (`limits.py`)."""


@dataclass(frozen=True)
class Rollout:
    """Rollouts of one size within a plan."""

    stage: Stage
    environments: int
    rows: int
    share: float = 0.0
    """Share of the library's effects that stand in the stack."""
    times: int = 1
    part: str = ""
    """`round`, `refitted`, `longer` or `terms`, which may be left out where time is up."""

    @property
    def steps(self) -> int:
        """Steps of environments."""
        return self.environments * self.rows * self.times


@dataclass(frozen=True)
class Plan:
    """A budget and what it comes to."""

    budget: Budget
    cost: Cost
    rollouts: tuple[Rollout, ...]
    notes: tuple[str, ...] = ()
    """What is lost by a budget that is not full, and whether it takes longer than allowed."""

    @property
    def seconds(self) -> float:
        """Expected run time [s]."""
        return sum(map(self._seconds, self.rollouts))

    @property
    def steps(self) -> int:
        """Steps of environments, expected."""
        return sum(r.steps for r in self.rollouts)

    def before(self, stage: Stage) -> tuple[float, int]:
        """Seconds and environment steps expected before a stage."""
        earlier = STAGES[: STAGES.index(stage)]
        parts = [r for r in self.rollouts if r.stage in earlier]
        return sum(map(self._seconds, parts)), sum(r.steps for r in parts)

    def until(self, stage: Stage) -> tuple[float, int]:
        """Seconds and environment steps expected until a stage has ended."""
        later = STAGES[STAGES.index(stage) + 1 :]
        return self.before(later[0]) if later else (self.seconds, self.steps)

    def needed(self, part: Part) -> float:
        """Seconds expected of a part, and of what must follow it.

        The first round goes before the sets that are fitted on at the end, these go before further
        rounds; where a budget has no time for all, it leaves them out in that order.
        """
        rounds = min(PLANNED_ROUNDS, self.budget.rounds)
        one = self._of("round") / rounds if rounds else 0.0
        last = self._of("refitted")
        answer = self.seconds - self.before("answer")[0] - self._of("longer") - self._of("terms")
        search = self.until("search")[0] - self.before("search")[0] - self._of("round") - last
        return {
            "first_round": one + answer,
            "round": one + last + answer,
            "refitted": last + answer,
            "longer": answer + self._of("longer"),
            "terms": answer + self._of("longer") + self._of("terms"),
            "experiments": 0.0,
            "retuning": search + answer,
        }[part]

    def _of(self, part: str) -> float:
        return sum(self._seconds(r) for r in self.rollouts if r.part == part)

    def _seconds(self, rollout: Rollout) -> float:
        one = self.cost.seconds(rollout.environments, rollout.rows, rollout.share)
        return rollout.times * one


def planned(question: Question, cost: Cost, minutes: float, spent: float = 0.0) -> Plan:
    """The largest budget that is expected to end in time; the smallest where none is.

    Args:
        question: The size of the diagnosis.
        cost: Of the simulator's rollouts.
        minutes: That are allowed; 0 for as many as it takes.
        spent: Seconds of them that have passed.
    """
    plans = (Plan(b, cost, tuple(planned_rollouts(question, b, cost.workers))) for b in smaller())
    plan = next(plans)
    while minutes and plan.seconds > HELD * (60 * minutes - spent):
        less = next(plans, None)
        if less is None:
            break
        plan = less
    return replace(plan, notes=tuple(_notes(question, plan, minutes, spent)))


def shortest(question: Question, cost: Cost, why: str) -> Plan:
    """The smallest budget, for a search whose findings cannot be believed; `why` is its note."""
    budget = [*smaller()][-1]
    return Plan(budget, cost, tuple(planned_rollouts(question, budget, cost.workers)), (why,))


def _notes(question: Question, plan: Plan, minutes: float, spent: float) -> Iterator[str]:
    loss = plan.budget.loss(question.segments)
    if loss:
        yield f"the simulator makes {plan.cost.rate:,.0f} environment steps a second: {loss}"
    step = MANY / plan.cost.rate
    if plan.cost.reset > SLOW_RESET * question.rows * step:
        yield (
            f"a reset of the simulator takes {plan.cost.reset:.2g} s, as long as "
            f"{plan.cost.reset / step:.0f} of its steps: every rollout waits for it"
        )
    expected = (plan.seconds + spent) / 60
    if minutes and expected > minutes:
        said = f"{expected:.{0 if expected >= 10 else 1}f}"
        yield (
            f"about {said} minutes are expected, more than minutes={minutes:g}: "
            "a smaller library by effects=[...] takes less, and so does a simulator that steps "
            "many environments at once"
        )


def planned_rollouts(question: Question, budget: Budget, workers: int = 1) -> Iterator[Rollout]:
    """What is rolled out after a simulator was measured, as far as it can be known before."""
    beside = min(2, workers)
    rows, count = question.rows, budget.segments(question.segments)
    trials = len(budget.sizes) * question.trials
    yield Rollout("prepare", 4 * count, rows, times=4)
    if question.baseline:
        yield Rollout("prepare", budget.segments(question.baseline), rows, times=CORRECTED)
    yield Rollout("search", 4 * count, rows, times=4)
    yield from _rolled_trials(trials * count, rows)
    yield from _fits(budget.sets, count, rows, budget)
    for _ in range(min(PLANNED_ROUNDS, budget.rounds)):
        yield Rollout("search", 7 * count, rows, 0.1, part="round")
        yield from _rolled_trials(trials * count, rows, "round")
        yield from _fits(2 + 3 * budget.around, count, rows, budget, "round")
    if budget.refitted:
        yield from _fits(budget.refitted, count, rows, budget, "refitted")
    if question.limits:
        yield from _fits(MISSING * question.limits, count, rows, budget)
    yield Rollout("answer", 2 * count, rows, 0.1, LOOKED)
    yield Rollout("answer", 2 * count, rows, 0.1, PROVED // beside)
    yield Rollout("answer", len(TRIED) * count, rows, 0.1, LEARNED * ITERATIONS)
    yield from _terms(count, rows, budget)
    if question.longer and budget.longer:
        yield Rollout(
            "answer", 3 * min(question.longer, count), 3 * rows, 0.1, TOLD // beside, "longer"
        )


def _terms(count: int, rows: int, budget: Budget) -> Iterator[Rollout]:
    """Rollouts in which terms are screened and the best of them fitted."""
    for share in (count // 2, count // 2, count) if budget.terms else ():  # halves and the whole
        screened = len(terms()) * min(share, budget.terms) // GLANCE
        yield Rollout("answer", screened, rows, 0.1, 1 + TERM_ROUNDS, "terms")
        for _ in range(TERM_ROUNDS):
            yield from _fits(FITTED, share, rows, budget, "terms", "answer")


def _rolled_trials(environments: int, rows: int, part: str = "") -> Iterator[Rollout]:
    yield Rollout("search", environments, rows, 1.0, part=part)


def _fits(
    sets: int, count: int, rows: int, budget: Budget, part: str = "", stage: Stage = "search"
) -> Iterator[Rollout]:
    """Rollouts of one batch: start, steps, derivatives where a damped one was best, held out."""
    many, times = sets * count, min(USUAL, budget.iterations)
    share = 0.5 if stage == "search" else 0.1
    yield Rollout(stage, (1 + NUMBERS) * many, rows, share, part=part)
    yield Rollout(stage, (1 + NUMBERS) * many * 2 // 3, rows, share, times, part)
    yield Rollout(stage, NUMBERS * many // 6, rows, 0.6 * share, times // 2, part)
    if budget.anew:
        yield Rollout(stage, many, rows, share, part=part)


MEASURED = 0.1  # [s] of a rollout by which time is measured, beside its warm-up


def plan_of(
    simulation: Simulation,
    library: Library,
    drives: Drives,
    minutes: float,
    begun: float | None = None,
    short: str = "",
    limits: int = 0,
) -> Plan:
    """The plan of a diagnosis in the time that it may take.

    Args:
        simulation: Of the simulator; its workers learn from it what is worth dividing.
        library: Effects to choose from.
        drives: To be compared.
        minutes: That the diagnosis may take.
        begun: When that time began (`time.perf_counter`); None for now.
        short: Why the search is as short as it can be, where `minutes` limits it at all.
        limits: Effects of the library that another of its effects becomes in a limit.
    """
    segments = drives.segments
    cost = measured_cost(
        simulation, segments.shortened(round(MEASURED / segments.dt)), library.effects
    )
    simulation.workers.least = cost.least_share
    question = Question(
        segments=len(segments),
        rows=segments.pose.shape[1] - 1,
        trials=sum(len(library.trials(name, segments, (1.0,))) for name in library.names),
        baseline=0 if drives.baseline is None else len(drives.baseline),
        longer=len(drives.longer.get(HORIZONS[-1], ())),
        limits=limits,
    )
    if short and minutes:
        return shortest(question, cost, short)
    spent = 0.0 if begun is None else time.perf_counter() - begun
    return planned(question, cost, minutes, spent)
