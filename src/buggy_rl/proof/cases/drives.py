"""Drives of cases: drivers from timid to daring, and how a car moves."""

import math
import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from buggy_rl.core import keys
from buggy_rl.core.car_file import CarFile
from buggy_rl.core.longitudinal import ONE_WAY
from buggy_rl.core.stepping import reset_at, trajectory
from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.effects.sensing.base import sensed_motion
from buggy_rl.policies.controllers.at_scale import ManoeuvringDriver, RoomAtScale
from buggy_rl.policies.controllers.room import RoomConfig, RoomDriver
from buggy_rl.proof.cases.case import BUGGY, Case
from buggy_rl.proof.plants import make_plant
from buggy_rl.proof.plants.composed import Disturbance
from buggy_rl.proof.plants.rally.declared import drawn_parameters
from buggy_rl.proof.plants.rally.owner import car_file, room
from buggy_rl.proof.plants.reference import make_reference
from buggy_rl.simulators.reference import ReferenceEngine
from buggy_rl.simulators.reference.faults import NEUTRAL

SPEED = 1.5  # [m/s] speed; a walking pace
PERIOD = 9.0  # [s] of the slalom
STEERED = 0.35  # [command] amplitude of the slalom


class SteadyDriver(RoomDriver):
    """Holds one speed in a slow slalom, and turns away from the walls as the room driver does."""

    def reset(self, batch_size) -> None:
        """Forgets the last drive and begins at a random phase of the slalom."""
        super().reset(batch_size)
        self.memory["phase"] = self._uniform(torch.Size(batch_size), 0.0, 2 * math.pi)

    def _steering(self) -> Tensor:
        self.memory["phase"] = self.memory["phase"] + 2 * math.pi * self.dt / PERIOD
        return STEERED * torch.sin(self.memory["phase"])

    def _drive(self, speed: Tensor) -> Tensor:
        return self._holding(torch.full_like(speed, SPEED)) + 0.3 * (SPEED - speed)


TIMID_DRIVE, TIMID_STEERING = 0.5, 0.65  # [-] shares of what the room driver commands


class TimidDriver(RoomDriver):
    """Half the throttle, two thirds of the steering."""

    def _drive(self, speed: Tensor) -> Tensor:
        return TIMID_DRIVE * super()._drive(speed)

    def _steering(self) -> Tensor:
        return TIMID_STEERING * super()._steering()


class WildDriver(RoomDriver):
    """Eases the throttle neither in bends nor in slides: its car spins now and then."""

    def _kept_straight(self, velocity: Tensor, drive: Tensor, steering: Tensor) -> Tensor:
        return drive


DRIVERS = {
    "rich": RoomDriver,
    "steady": SteadyDriver,
    "timid": TimidDriver,
    "wild": WildDriver,
}
BASELINE = 500_000_000  # added to a seed for the drives before the change


@dataclass(frozen=True)
class TrueMotion:
    """True motion of a case's cars, [cars, T] each."""

    changed: TensorDict
    """Motion of the car with what is concealed: the drives to be seen, then those held out."""
    clean: TensorDict | None
    """Motion of the car before, where baseline drives are given."""


Driver = Callable[[TensorDictBase], TensorDictBase]
"""Writes `action` for what it sees."""


def drive_cases(cases: Sequence[Case]) -> list[TrueMotion]:
    """Drives cars of cases that share plant, length, rate and scale; reference cars in one batch.

    Every case has drivers of its own: its motion does not depend on the other cases.
    """
    rows, plant = round(cases[0].seconds / CONTROL_PERIOD), cases[0].plant
    sizes, drivers, faults, parameters, disturbances = [], [], [], [], []
    for case in cases:
        own = plant_parameters(case)
        sizes.append(case.drives + case.held_out)
        drivers.append(driver_of(case, case.seed))
        faults.append(case.faults)
        parameters.append(own)
        disturbances.append(case.disturbances)
        if case.baseline:
            sizes.append(case.drives)
            drivers.append(driver_of(case, case.seed + BASELINE))
            faults.append({})
            parameters.append(own)
            disturbances.append([])
    poses = [driver.start_pose([size]) for driver, size in zip(drivers, sizes, strict=True)]
    if plant == "reference":
        engine = _reference_cars(faults, parameters, sizes, cases[0])
        act = acting(disturbances, sizes)
        driver = joined(drivers, sizes)
        parts = true_drive(engine, driver, torch.cat(poses), rows, act, cases[0].every).split(sizes)
    else:
        parts = [
            true_drive(
                make_plant(plant, size, own, numbers),
                driver,
                pose,
                rows,
                acting([beside], [size]),
                cases[0].every,
            )
            for driver, pose, own, numbers, beside, size in zip(
                drivers, poses, faults, parameters, disturbances, sizes, strict=True
            )
        ]
    motion = iter(parts)
    return [TrueMotion(next(motion), next(motion) if case.baseline else None) for case in cases]


def driver_of(case: Case, seed: int) -> RoomAtScale | ManoeuvringDriver | RoomDriver:
    """Who drives the car of a case."""
    scale = case.car.similarity
    driver = _driver_of(case, seed, case.every * CONTROL_PERIOD / scale.time)
    return driver if case.scale == BUGGY else RoomAtScale(driver, scale)


def _driver_of(case: Case, seed: int, dt: float) -> ManoeuvringDriver | RoomDriver:
    """The buggy's driver, with a command every `dt` [s] of the buggy's time."""
    forward = DRIVERS[case.driving](_room(case), seed=seed, dt=dt)
    if case.longitudinal == ONE_WAY:
        return forward
    return ManoeuvringDriver(seed=seed, command=case.longitudinal, dt=dt, forward=forward)


def _room(case: Case) -> RoomConfig | None:
    """The room, and what the driver believes of the car; None for the buggy's."""
    return room(plant_parameters(case)) if case.plant == "rally" else None


def measured_car(case: Case) -> CarFile | None:
    """The file of a case's unchanged car, as its owner measured it; None for the buggy."""
    if case.plant == "rally":
        return car_file(plant_parameters(case))
    return None if case.scale == BUGGY else case.car


def plant_of(
    case: Case,
    cars: int,
    faults: Mapping[str, Mapping[str, float]],
    parameters: Mapping[str, float] | None = None,
) -> EnvBase:
    """Cars of a case's plant that take its command."""
    if case.longitudinal == ONE_WAY and case.scale == BUGGY:
        return make_plant(case.plant, cars, faults, parameters)
    size = None if case.scale == BUGGY else case.car.vehicle
    return make_reference(cars, faults, parameters, case.longitudinal, size)


def plant_parameters(case: Case) -> dict[str, float]:
    """The parameters of a case's plant that are not its own: each within `spread` of that.

    Of a rally car they are all drawn.
    """
    chance = random.Random(f"plant {case.key}")
    if case.plant == "rally":
        return drawn_parameters(chance.getrandbits(64))
    if not case.spread:
        return {}
    found = {}
    for name, p in plant_of(case, 1, {}).declared.items():  # type: ignore[attr-defined]
        value = p.value * (1 + chance.uniform(-case.spread, case.spread))
        found[name] = min(max(value, p.lower), p.upper)
    return found


def _reference_cars(
    faults: Sequence[Mapping[str, Mapping[str, float]]],
    parameters: Sequence[Mapping[str, float]],
    sizes: Sequence[int],
    case: Case,
) -> EnvBase:
    """One batch of cars like that of a case, with the faults and parameters of each part."""
    count, first = sum(sizes), 0
    tensors: dict[str, Tensor] = {}
    cars = plant_of(case, count, {})
    assert isinstance(cars, ReferenceEngine)
    numbers: dict[str, Tensor] = {}
    for own, size in zip(parameters, sizes, strict=True):
        for name, value in own.items():
            usual = torch.full((count,), cars.declared[name].value)
            numbers.setdefault(name, usual)[first : first + size] = value
        first += size
    if numbers:
        cars = cars.with_parameters(TensorDict(numbers, [count]))
    first = 0
    for own, size in zip(faults, sizes, strict=True):
        for effect, values in own.items():
            for name, value in values.items():
                key = f"{effect}.{name}"
                rows = tensors.setdefault(key, torch.full((count,), NEUTRAL[key]))
                rows[first : first + size] = value
        first += size
    return cars.with_faults(TensorDict(tensors, [count]))


def acting(disturbances: Sequence[Sequence[Disturbance]], sizes: Sequence[int]) -> Driver | None:
    """What disturbs each part of a batch, one after the other; None where nothing does."""
    if not any(disturbances):
        return None

    def act(state: TensorDictBase) -> TensorDictBase:
        seen = (keys.POSE, keys.VELOCITY, keys.ACTION)
        parts = state.select(*seen).split(list(sizes))
        for part, beside in zip(parts, disturbances, strict=True):
            for disturbance in beside:
                disturbance.acting(part)
        return state.update({key: torch.cat([part[key] for part in parts]) for key in seen})

    return act


def joined(drivers: Sequence[Driver], sizes: Sequence[int]) -> Driver:
    """One driver for a batch whose parts have drivers of their own."""
    seen = (keys.POSE, keys.VELOCITY, keys.OBSERVATION)

    def drive(state: TensorDictBase) -> TensorDictBase:
        parts = state.select(*seen, strict=False).split(list(sizes))
        actions = [driver(part)[keys.ACTION] for driver, part in zip(drivers, parts, strict=True)]
        return state.set(keys.ACTION, torch.cat(actions))

    return drive


@torch.no_grad()
def true_drive(
    engine: EnvBase,
    driver: Driver,
    pose: Tensor,
    rows: int,
    act: Driver | None = None,
    every: int = 1,
) -> TensorDict:
    """True motion [N, rows] from rest at poses [N, 3], with the commands as they are given.

    Args:
        engine: N cars.
        driver: Writes the command for what it sees.
        pose: Where they start.
        rows: Control periods.
        act: Changes command and motion behind the driver's back.
        every: Rows for which a command is held.
    """
    start = {keys.POSE: pose, keys.VELOCITY: torch.zeros_like(pose)}
    state = reset_at(engine, TensorDict(start, engine.batch_size))
    given = []

    def commanded(row: int, now: TensorDictBase) -> TensorDictBase:
        now = now.set(keys.ACTION, given[-1].clone()) if row % every else driver(now)
        given.append(now[keys.ACTION].clone())
        return now if act is None else act(now)

    states = pairwise(trajectory(engine, state, commanded, rows))
    seen = [tuple(value.clone() for value in sensed_motion(now)) for now, _ in states]
    trail = zip((keys.POSE, keys.VELOCITY), zip(*seen, strict=True), strict=True)
    motion = TensorDict({key: torch.stack(rows, 1) for key, rows in trail}, [len(pose), rows])
    return motion.set(keys.ACTION, torch.stack(given, 1))  # type: ignore[return-value]
