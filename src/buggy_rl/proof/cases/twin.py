"""Twins: drives of simulated cars in the place of recordings that cannot be shipped.

A twin has the size, the command, the sensor, the rate, the gaps and glitches of a kind of car, and
its tables have other names and units than ours. Its physics is a single track with parameters of
its own, before and after something about it has changed.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
import yaml
from numpy import ndarray
from omegaconf import MISSING
from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from buggy_rl.core.car_file import PRESETS, CarFile, load_car
from buggy_rl.core.files import write_atomically
from buggy_rl.core.longitudinal import declared_by
from buggy_rl.core.parameters import Parameter
from buggy_rl.core.vehicle import CONTROL_PERIOD, Similarity
from buggy_rl.policies.controllers.at_scale import ManoeuvringDriver, RoomAtScale
from buggy_rl.policies.controllers.recording import recorded_steps
from buggy_rl.policies.controllers.room import RoomConfig
from buggy_rl.recordings.sensors import sensor_columns, sensor_errors
from buggy_rl.simulators import make_engine
from buggy_rl.task.augment import augmented

BEFORE, AFTER, ANSWER = "before", "after", "answer"
"""Folders of a twin: drives of the car as it was, drives since it has changed, the answer."""
CAR, COLUMNS = "car.yaml", "columns.yaml"


@dataclass(frozen=True)
class TwinColumn:
    """A column of a foreign table: raw = offset + factor * value in SI units."""

    name: str = MISSING
    factor: float = 1.0
    offset: float = 0.0
    decimals: int = 6


@dataclass(frozen=True)
class TwinConfig:
    """Settings of one twin."""

    output: str = MISSING
    """Folder for before/, after/, car.yaml and answer/."""
    car: str = MISSING
    """A name in configs/cars, or a file."""
    command: str = "throttle_brake_reverse"
    """Kind of the first command, in the place of the car file's."""
    kind: str = ""
    """Kind of the sensor, in the place of the car file's."""
    sensor: dict[str, Any] = field(default_factory=dict)
    """Errors that differ from those of this kind of sensor (`recordings.sensors`)."""
    truth: dict[str, float] = field(default_factory=dict)
    """Parameters of the true car, times what the single track ships with for this car."""
    changed: dict[str, float] = field(default_factory=dict)
    """Parameters that have changed after, as values in their units."""
    drives: int = 3
    """Drives before, and as many after."""
    seconds: float = 60.0
    """Length of each [s]."""
    period: float = CONTROL_PERIOD
    """Period at which the car is simulated and driven [s]."""
    seed: int = 0
    table: dict[str, TwinColumn] = field(default_factory=dict)
    """Channel -> column: t, x, y, yaw, qw, qx, qy, qz, vx, vy, speed, yaw_rate, throttle,
    steering."""
    columns: dict[str, Any] = field(default_factory=dict)
    """The right column map, which goes to answer/."""
    room: RoomConfig = field(
        default_factory=lambda: RoomConfig(drive_at_rest=0.22, drive_per_speed=0.06)
    )
    """Room of the driver, for the buggy; scaled to the car."""


def car_content(config: TwinConfig) -> dict[str, Any]:
    """The car's file with the twin's command."""
    file = Path(config.car) if config.car.endswith(".yaml") else PRESETS / f"{config.car}.yaml"
    content = yaml.safe_load(file.read_text())
    kind = {"kind": config.kind} if config.kind else {}
    sensor = {**content.get("sensor", {}), **kind}
    return {**content, "command": {"kind": config.command}, "sensor": sensor}


def parameters(config: TwinConfig, car: str, changed: bool) -> dict[str, float]:
    """Parameters of the true car, before or after the change.

    Raises:
        ValueError: The single track has no such parameter.
    """
    declared = _declared(make_engine("single_track", (), car=car))
    unknown = sorted({*config.truth, *config.changed} - set(declared))
    if unknown:
        raise ValueError(
            f"truth or changed: no parameter {', '.join(unknown)}; available: "
            f"{', '.join(sorted(declared))}"
        )
    own = {name: factor * declared[name].value for name, factor in config.truth.items()}
    return own | (dict(config.changed) if changed else {})


def _declared(engine: EnvBase) -> Mapping[str, Parameter]:
    """What an engine declares."""
    declared: Any = engine.declared
    return declared


def motions(config: TwinConfig, car: CarFile, file: str) -> Iterator[TensorDictBase]:
    """Yields rows [2 * drives] of true motion, one a period: before, then after."""
    count = 2 * config.drives
    engine = make_engine("single_track", count, car=file, dt=config.period)
    own = [parameters(config, file, changed) for changed in (False, True)]
    given = _declared(engine)
    values = {name: torch.tensor([p.get(name, given[name].value) for p in own]) for name in own[1]}
    each = {name: value.repeat_interleave(config.drives) for name, value in values.items()}
    env, _ = augmented(engine, {}, each)
    scale = Similarity.between(car.vehicle)
    dt = config.period * scale.speed / scale.length
    driver = ManoeuvringDriver(config.room, config.seed, declared_by(engine), dt=dt)
    steps = round(config.seconds / config.period)
    yield from recorded_steps(env, RoomAtScale(driver, scale), steps)


def foreign(values: Mapping[str, ndarray], table: Mapping[str, TwinColumn]) -> pd.DataFrame:
    """A table with other names and units.

    Raises:
        ValueError: A channel is none.
    """
    half = values["yaw"] / 2
    more = {
        "qw": np.cos(half),
        "qx": 0 * half,
        "qy": 0 * half,
        "qz": np.sin(half),
        "speed": np.hypot(values["vx"], values["vy"]),
    }
    known = {**values, **more}
    unknown = sorted(set(table) - set(known))
    if unknown:
        raise ValueError(f"table: no channel {', '.join(unknown)}; available: {', '.join(known)}")
    known["yaw"] = np.arctan2(np.sin(values["yaw"]), np.cos(values["yaw"]))  # wrapped
    return pd.DataFrame(
        {
            column.name: np.round(column.offset + column.factor * known[channel], column.decimals)
            for channel, column in table.items()
        }
    )


def recorded(config: TwinConfig) -> Iterator[float]:
    """Drives, measures and writes a twin; yields the share that is done after every row."""
    folder = Path(config.output)
    file = folder / CAR
    write_atomically(file, yaml.safe_dump(car_content(config), sort_keys=False))
    car = load_car(str(file))
    errors = sensor_errors(car.sensor.kind, config.sensor)
    steps, rows = round(config.seconds / config.period), []
    for row in motions(config, car, str(file)):
        rows.append(row)
        yield len(rows) / steps
    motion: Any = torch.stack(rows, 1)  # (2 * drives, T)
    for number, drive in enumerate(motion.unbind(0)):
        part, index = (BEFORE, AFTER)[number // config.drives], number % config.drives
        seen = sensor_columns(drive, errors, config.period, 1000 * config.seed + number)
        (folder / part).mkdir(parents=True, exist_ok=True)
        foreign(seen, config.table).to_csv(folder / part / f"run_{index}.csv", index=False)
    answer = {"before": parameters(config, str(file), False), "changed": dict(config.changed)}
    (folder / ANSWER).mkdir(exist_ok=True)
    write_atomically(folder / ANSWER / "truth.yaml", yaml.safe_dump(answer, sort_keys=False))
    content = yaml.safe_dump(config.columns, sort_keys=False)
    write_atomically(folder / ANSWER / COLUMNS, content)
