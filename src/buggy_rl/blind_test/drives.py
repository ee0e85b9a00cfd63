"""Drives of cases: how a car moves, and what its camera records of that."""

import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from scipy.signal import lfilter
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from buggy_rl import keys
from buggy_rl.blind_test.case import Case
from buggy_rl.blind_test.hands import TimidDriver, WildDriver
from buggy_rl.blind_test.steady_driver import SteadyDriver
from buggy_rl.engines.reference import ReferenceEngine
from buggy_rl.engines.reference.faults import NEUTRAL
from buggy_rl.longitudinal import ONE_WAY, LongitudinalCommand
from buggy_rl.plants import make_plant
from buggy_rl.plants.composed import Disturbance
from buggy_rl.plants.reference import make_reference
from buggy_rl.policies.controllers.manoeuvring import ManoeuvringDriver
from buggy_rl.policies.controllers.room import RoomDriver
from buggy_rl.recordings import Recording, save_recording
from buggy_rl.recordings.camera import DECIMALS, NOISES, Camera, CameraConfig
from buggy_rl.stepping import trajectory
from buggy_rl.vehicle import CONTROL_PERIOD

DRIVERS = {
    "rich": RoomDriver,
    "steady": SteadyDriver,
    "timid": TimidDriver,
    "wild": WildDriver,
}
BASELINE = 500_000_000  # added to a seed for the drives before the change
BASELINE_NOISE = 100  # number of the first baseline drive, behind those of all other drives
RHO = 0.9  # correlation of coloured noise from row to row
JITTER = 1e-3  # [s] standard deviation of a stamp: a host computer that stamps on arrival
DROPPED = 0.002  # share of frames lost: one in five seconds, each of which cuts the drive


@dataclass(frozen=True)
class Motion:
    """True motion of a case's cars, [cars, T] each."""

    changed: TensorDict
    """Of the car with what is concealed: the drives to be seen, then those held out."""
    clean: TensorDict | None
    """Of the car before, where baseline drives are given."""


Driver = Callable[[TensorDictBase], TensorDictBase]
"""Writes `action` for what it sees."""


def moved(cases: Sequence[Case]) -> list[Motion]:
    """Drives the cars of cases that share plant and length; reference cars in one batch.

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
        engine = _reference_cars(faults, parameters, sizes, cases[0].longitudinal)
        act = acting(disturbances, sizes)
        parts = driven(engine, joined(drivers, sizes), torch.cat(poses), rows, act).split(sizes)
    else:
        parts = [
            driven(
                make_plant(plant, size, own, numbers), driver, pose, rows, acting([beside], [size])
            )
            for driver, pose, own, numbers, beside, size in zip(
                drivers, poses, faults, parameters, disturbances, sizes, strict=True
            )
        ]
    motion = iter(parts)
    return [Motion(next(motion), next(motion) if case.baseline else None) for case in cases]


def driver_of(case: Case, seed: int) -> ManoeuvringDriver | RoomDriver | SteadyDriver:
    """Who drives the car of a case.

    Raises:
        ValueError: The case's driving is one that such a car has no driver for.
    """
    if case.longitudinal == ONE_WAY:
        return DRIVERS[case.driving](seed=seed)
    if case.driving != "rich":
        raise ValueError(f"case {case.id}: only rich driving brakes and reverses: driving=[rich]")
    return ManoeuvringDriver(seed=seed, command=case.longitudinal)


def plant_of(
    case: Case,
    cars: int,
    faults: Mapping[str, Mapping[str, float]],
    parameters: Mapping[str, float] | None = None,
) -> EnvBase:
    """Cars of a case's plant that take its command."""
    if case.longitudinal == ONE_WAY:
        return make_plant(case.plant, cars, faults, parameters)
    return make_reference(cars, faults, parameters, case.longitudinal)


def plant_parameters(case: Case) -> dict[str, float]:
    """The parameters of a case's plant that are not its own: each within `spread` of that."""
    if not case.spread:
        return {}
    chance = random.Random(f"plant {case.seed}")
    found = {}
    for name, p in plant_of(case, 1, {}).declared.items():  # type: ignore[attr-defined]
        value = p.value * (1 + chance.uniform(-case.spread, case.spread))
        found[name] = min(max(value, p.lower), p.upper)
    return found


def _reference_cars(
    faults: Sequence[Mapping[str, Mapping[str, float]]],
    parameters: Sequence[Mapping[str, float]],
    sizes: Sequence[int],
    command: LongitudinalCommand = ONE_WAY,
) -> EnvBase:
    """One batch with the faults and parameters of each part."""
    count, first = sum(sizes), 0
    tensors: dict[str, Tensor] = {}
    cars = ReferenceEngine(count, command=command)
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
def driven(
    engine: EnvBase, driver: Driver, pose: Tensor, rows: int, act: Driver | None = None
) -> TensorDict:
    """True motion [N, rows] from rest at poses [N, 3], with the commands as they are given.

    Args:
        engine: N cars.
        driver: Writes the command for what it sees.
        pose: Where they start.
        rows: Control periods.
        act: Changes command and motion behind the driver's back.
    """
    start = {keys.POSE: pose, keys.VELOCITY: torch.zeros_like(pose)}
    state = engine.reset(TensorDict(start, engine.batch_size))
    given = []

    def commanded(_: int, now: TensorDictBase) -> TensorDictBase:
        now = driver(now)
        given.append(now[keys.ACTION].clone())
        return now if act is None else act(now)

    states = pairwise(trajectory(engine, state, commanded, rows))
    trail = [now.select(keys.POSE, keys.VELOCITY).clone() for now, _ in states]
    motion = TensorDict.stack(trail, 1)
    return motion.set(keys.ACTION, torch.stack(given, 1))  # type: ignore[return-value]


def save_drives(
    case: Case, true: TensorDict, folder: Path, numbers: Mapping[str, int], changed: bool = True
) -> None:
    """Records drives of a case, true motion [drives, T], and writes them as CSV files.

    `numbers` is file name, without its ending -> `place` of `measured`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for motion, (name, number) in zip(true, numbers.items(), strict=True):
        save_recording(measured(case, motion, changed, number), folder / f"{name}.csv")


def measured(case: Case, true: TensorDict, changed: bool, place: int) -> Recording:
    """One drive of a case as it is recorded.

    Args:
        case: Says what is wrong with the camera, and the nuisance.
        true: [T] motion.
        changed: Whether what is concealed is there yet; if not, the camera is right.
        place: Number of the drive, which decides its noise.
    """
    seed = case.seed * 1_000 + place
    config = CameraConfig(**(case.camera if changed else {}))
    for disturbance in case.disturbances if changed else ():
        true = disturbance.seen(true)
    if case.nuisance == "stamps":
        true = stamped_off(true, early=random.Random(f"stamps {case.seed}").random() < 0.5)
    if case.nuisance == "thrice":
        config = replace(config, **{name: 3 * getattr(config, name) for name in NOISES})
    if case.nuisance == "dropped":
        config = replace(config, dropped_share=DROPPED)
    if case.nuisance == "coloured":
        data = coloured(config, true, seed)
    else:
        data = Camera(config, seed).recorded(true)
    if case.nuisance == "jitter":
        data[keys.TIME] = jittered(data[keys.TIME], seed)
    return Recording(f"drive_{place}", data, CONTROL_PERIOD, command=case.longitudinal)


def stamped_off(true: TensorDict, early: bool) -> TensorDict:
    """The motion with its commands logged a row early, or late; the last, or first, is held."""
    action = true[keys.ACTION]
    moved = torch.cat([action[1:], action[-1:]]) if early else torch.cat([action[:1], action[:-1]])
    return true.clone().set(keys.ACTION, moved)


def coloured(config: CameraConfig, true: TensorDict, seed: int) -> TensorDict:
    """Recorded with noise e_k = rho e_(k-1) + sqrt(1 - rho^2) w_k of the camera's own size."""
    quiet = replace(config, **dict.fromkeys(NOISES, 0.0))
    data = Camera(quiet, seed).recorded(true)
    position, yaw, speed, yaw_rate = (getattr(config, name) for name in NOISES)
    noise = correlated(len(data), 6, seed)
    for key, rows, size in (
        (keys.POSE, slice(0, 3), (position, position, yaw)),
        (keys.VELOCITY, slice(3, 6), (speed, speed, yaw_rate)),
    ):
        shown = data[key] + noise[:, rows] * torch.tensor(size)
        data[key] = torch.round(shown, decimals=DECIMALS)
    return data


def correlated(rows: int, columns: int, seed: int) -> Tensor:
    """Noise [rows, columns] of unit variance with correlation `RHO` from row to row."""
    generator = torch.Generator().manual_seed(seed)
    white = torch.randn(rows, columns, generator=generator, dtype=torch.float64).numpy()
    white[1:] *= np.sqrt(1 - RHO**2)  # the first row has the variance that all shall have
    return torch.as_tensor(lfilter([1.0], [1.0, -RHO], white, axis=0)).float()


def jittered(time: Tensor, seed: int) -> Tensor:
    """Stamps [T, 1] that are off by `JITTER`, in order still."""
    generator = torch.Generator().manual_seed(seed)
    off = JITTER * torch.randn(time.shape, generator=generator, dtype=time.dtype)
    return (time + off.clamp(-4 * JITTER, 4 * JITTER)).round(decimals=DECIMALS)
