"""How the cars of cases really moved: the part of a case that no camera has seen yet."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from buggy_rl import keys
from buggy_rl.blind_test.case import Case
from buggy_rl.blind_test.steady_driver import SteadyDriver
from buggy_rl.engines.reference import ReferenceEngine
from buggy_rl.engines.reference.faults import NEUTRAL
from buggy_rl.plants import make_plant
from buggy_rl.policies.controllers.room import RoomDriver
from buggy_rl.vehicle import CONTROL_PERIOD

DRIVERS = {"rich": RoomDriver, "steady": SteadyDriver}
BASELINE = 500_000_000  # added to a seed for the drives before the change


@dataclass(frozen=True)
class Motion:
    """True motion of a case's cars, [cars, T] each."""

    changed: TensorDict
    """Of the car with what is concealed: the drives to be seen, then those held out."""
    clean: TensorDict | None
    """Of the car before, where baseline drives are given."""


class Driver(Protocol):
    """Who drives some cars."""

    def start_pose(self, batch_size: Sequence[int], /) -> Tensor:
        """Poses [*batch, 3] to begin at."""
        ...

    def __call__(self, seen: TensorDictBase, /) -> TensorDictBase:
        """Writes `action` for `pose` and `velocity`."""
        ...


@dataclass(frozen=True)
class Ride:
    """Cars that one driver drives."""

    driver: Driver
    rows: slice


def moved(cases: Sequence[Case]) -> list[Motion]:
    """Drives the cars of cases that share plant and length; reference cars all at once.

    Every case has drivers of its own, so that it is the same whatever is made beside it.
    """
    rows = round(cases[0].seconds / CONTROL_PERIOD)
    if cases[0].plant == "reference":
        return _together(cases, rows)
    result = []
    for case in cases:
        cars = case.drives + case.held_out
        changed = driven(make_plant(case.plant, cars, case.faults), [_ride(case, cars)], rows)
        clean = None
        if case.baseline:
            engine = make_plant(case.plant, case.drives, {})
            clean = driven(engine, [_ride(case, case.drives, BASELINE)], rows)
        result.append(Motion(changed, clean))
    return result


def _together(cases: Sequence[Case], steps: int) -> list[Motion]:
    rides, places, count = [], [], 0
    faults: dict[str, list[tuple[slice, float]]] = {}
    for case in cases:
        cars = case.drives + case.held_out
        changed = slice(count, count + cars)
        clean = slice(count + cars, count + cars + (case.drives if case.baseline else 0))
        count = clean.stop
        for effect, values in case.faults.items():
            for name, value in values.items():
                faults.setdefault(f"{effect}.{name}", []).append((changed, value))
        rides.append(_ride(case, cars, first=changed.start))
        if case.baseline:
            rides.append(_ride(case, case.drives, BASELINE, clean.start))
        places.append((changed, clean))
    tensors = {}
    for name, parts in faults.items():
        tensors[name] = torch.full((count,), NEUTRAL[name])
        for rows, value in parts:
            tensors[name][rows] = value
    engine = ReferenceEngine(count).with_faults(TensorDict(tensors, [count]))
    true = driven(engine, rides, steps)
    return [
        Motion(true[changed], true[clean] if clean.stop > clean.start else None)
        for changed, clean in places
    ]


def _ride(case: Case, cars: int, salt: int = 0, first: int = 0) -> Ride:
    return Ride(DRIVERS[case.driving](seed=case.seed + salt), slice(first, first + cars))


@torch.no_grad()
def driven(engine: EnvBase, rides: Sequence[Ride], rows: int) -> TensorDict:
    """True motion [cars, rows]; all drive off from rest."""
    size = [ride.rows.stop - ride.rows.start for ride in rides]
    pose = torch.cat([r.driver.start_pose([n]) for r, n in zip(rides, size, strict=True)])
    start = {keys.POSE: pose, keys.VELOCITY: torch.zeros_like(pose)}
    state, trail = engine.reset(TensorDict(start, engine.batch_size)), []
    for _ in range(rows):
        seen = state.select(keys.POSE, keys.VELOCITY)
        state[keys.ACTION] = torch.cat([r.driver(seen[r.rows])[keys.ACTION] for r in rides])
        trail.append(state.select(keys.POSE, keys.VELOCITY, keys.ACTION).clone())
        state = engine.step(state)["next"]
    return TensorDict.stack(trail, 1)  # type: ignore[return-value]
