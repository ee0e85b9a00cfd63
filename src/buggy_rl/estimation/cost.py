"""How long rollouts of a simulator take, measured before any are planned."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from buggy_rl.effects import effect_class
from buggy_rl.estimation.rollout import (
    ALONE,
    AS_GIVEN,
    MOST_ENVIRONMENTS,
    ParameterSets,
    Simulation,
    tell_nobody,
)
from buggy_rl.estimation.segments import Segments

FEW, MANY = 8, 512  # environments in which the time of a step is measured
SETS = (8, MANY // FEW)  # times as many as the few
OFTEN, QUICK = 3, 0.3  # times that a rollout is timed; [s] after which it is not again
LONGEST = 3.0  # [s] that one of these rollouts may take beyond twice that of a few
GAINED = 4  # a worker's share must take a quarter as long as a step of none: then it gains 20 %


@dataclass(frozen=True)
class Cost:
    """Seconds of a step of B environments: fixed + effects E / all + each B."""

    fixed: float
    """[s] of a step of no environments: calls, whatever the batch."""
    each: float
    """[s] of a step of each environment."""
    effects: float = 0.0
    """[s] that all effects of the library add to the fixed time, where all stand in the stack."""
    reset: float = 0.0
    """[s] of a reset."""
    workers: int = 1
    """Processes among which large batches are divided."""

    def seconds(self, environments: int, rows: int, share: float = 0.0) -> float:
        """Seconds of a rollout.

        Args:
            environments: B.
            rows: Steps.
            share: Of the library's effects that stand in the stack, 0 to 1.
        """
        fixed = self.fixed + share * self.effects
        busy = max(1, min(self.workers, environments // self.least_share))
        own = environments / busy  # of each process
        calls = math.ceil(own / MOST_ENVIRONMENTS)
        return self.reset + rows * (calls * fixed + self.each * own)

    @property
    def least_share(self) -> int:
        """Environments from which on a further worker is worth its fixed time."""
        return max(16, round(self.fixed / GAINED / max(self.each, 1e-9)))

    @property
    def rate(self) -> float:
        """Environment steps a second, in a batch of `MANY`."""
        return MANY / (self.fixed + self.each * MANY)


def measured_cost(simulation: Simulation, segments: Segments, effects: Sequence[str]) -> Cost:
    """Times rollouts of few and of many environments, and of all effects in one stack.

    Args:
        simulation: Of the simulator; in this process alone.
        segments: Short ones, of which the first few are rolled out.
        effects: Of the library; parameters of the simulator's own cost nothing.
    """
    alone = replace(simulation, workers=ALONE, rolled=tell_nobody)
    few = segments[torch.arange(FEW) % len(segments)]
    rows = few.pose.shape[1] - 1
    first = _timed(alone, few, AS_GIVEN)
    if first < LONGEST:  # it may have built, loaded and compiled what a first call does
        first = _timed(alone, few, AS_GIVEN)
    reset = _reset(alone, FEW)
    each = 0.0
    for sets in SETS:
        if each * FEW * sets * rows > LONGEST + 2 * first:
            break
        many = _timed(alone, few, ParameterSets(clock_offset=torch.zeros(sets)))
        each = max(0.0, many - first) / (FEW * (sets - 1)) / rows
    fixed = max((first - reset) / rows - each * FEW, 1e-7)
    cost = Cost(fixed, each, reset=reset)
    if effects and first < LONGEST:  # of a slow simulator they take a small part
        stack = _timed(alone, few, _one_each(effects)) / rows
        own = stack - reset / rows - fixed - each * FEW * len(effects)
        cost = replace(cost, effects=max(0.0, own))
    return replace(cost, workers=simulation.workers.count)


def _timed(simulation: Simulation, segments: Segments, settings: ParameterSets) -> float:
    """Seconds of a rollout: the least of some, where they are quick, since a stall only adds."""
    taken: list[float] = []
    while len(taken) < OFTEN and sum(taken) < QUICK:
        begun = time.perf_counter()
        simulation.readings(segments, settings)
        taken.append(time.perf_counter() - begun)
    return min(taken)


def _reset(simulation: Simulation, environments: int) -> float:
    env = simulation.make(environments)
    begun = time.perf_counter()
    env.reset()
    return time.perf_counter() - begun


def _one_each(effects: Sequence[str]) -> ParameterSets:
    """Makes as many sets as effects, each with one of them, so that all stand in the stack."""
    values: dict[str, dict[str, torch.Tensor]] = {}
    for index, effect in enumerate(effects):
        own = {p.name: torch.full((len(effects),), p.value) for p in effect_class(effect).declared}
        for p in effect_class(effect).declared:
            own[p.name][index] = min(max(p.value + p.probe, p.lower), p.upper)
        values[effect] = own
    return ParameterSets(values)
