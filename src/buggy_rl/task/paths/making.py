"""Makes paths from a config."""

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Literal, get_args

import numpy as np
import torch
from numpy.typing import NDArray

from buggy_rl.core.car_file import load_car
from buggy_rl.task.paths.path_set import PathSet, equal_paths, joined_paths
from buggy_rl.task.paths.shapes import along_arcs, read_points, simplex_paths

Kind = Literal["simplex", "lap", "infinity", "circle", "tight", "file"]
Part = Literal["training", "validation", "selection"]  # the order seeds them
# The tight path stands in for the original study's third one, which had to fit its 8 m room.
TIGHT_ROOM = 6.0  # [m] side of the square of its noise; the path itself covers 4.0 m x 3.4 m
TIGHT_RADIUS = 0.6  # [m] about what the car can just turn
TIGHT_WAYPOINTS = 120  # 24 m, further than the car gets in the original's 5 s
LENGTHS = ("spacing", "straight_spacing", "room", "sharpest_radius", "radius", "straight")
TIGHT_SEED = 8  # of the first twelve, the one that turns as much to the left as to the right


@dataclass(frozen=True)
class PathConfig:
    """Which paths."""

    kind: Kind = "simplex"
    """simplex (random), lap, infinity, circle, tight (one hard random path), or file."""
    part: Part = "training"
    """Part of the random paths: training, selection (of the best policy) or validation; they share
    none."""
    count: int = 1000
    """Random paths for training."""
    validation_count: int = 10
    """Random paths for validation, and as many for selection."""
    waypoints: int = 500
    """Waypoints of a random path."""
    spacing: float = 0.2
    """Distance between waypoints along the path [m]; closed paths take the nearest that fits."""
    straight_spacing: float = 0.0
    """Distance between waypoints where a random path is straight [m], as in the original study
    longer than in its turns; it falls to `spacing` in the sharpest. 0 for `spacing` everywhere."""
    room: float = 20.0
    """Side of the square that the noise of a random path can fill [m]."""
    sharpest_radius: float = 0.6
    """Tightest turn of a random path [m]; 0 leaves the noise as it is, cusps and all."""
    radius: float = 1.0
    """Radius of lap, infinity and circle [m]."""
    straight: float = 2.0
    """Length of a straight of the lap [m]."""
    file: str = ""
    """CSV with columns x, y [m]; closed when its last row repeats its first."""
    mirrored: bool = False
    """Adds every path's mirror image."""
    placed: bool = False
    """Puts every path somewhere in the room, in any direction, instead of at the origin."""
    seed: int = 0
    """Seed of noise and places."""
    car: str = ""
    """Car, by name or file, that every length here and in the task's transforms is scaled to; empty
    for the buggy."""


@dataclass(frozen=True)
class ShowPathsConfig:
    """A picture of paths."""

    output: str = "runs/paths.png"
    """The picture: .png, .svg or .pdf."""
    paths: PathConfig = field(default_factory=PathConfig)
    """What the paths are made of; a kind of file is drawn beside all others."""
    shown: int = 5
    """Random paths that are picked out; the others are drawn faintly."""
    waypoints: int = 100
    """Waypoints of each random path that are drawn; the original study's figures show as many."""


def path_sets(config: ShowPathsConfig) -> dict[str, PathSet]:
    """Every kind of path by name; one's own from a file first."""
    chosen = {
        "training": replace(config.paths, kind="simplex", part="training"),
        "validation": replace(config.paths, kind="simplex", part="validation"),
    }
    chosen |= {k: replace(config.paths, kind=k) for k in ("lap", "infinity", "circle", "tight")}
    if config.paths.kind == "file":
        chosen = {Path(config.paths.file).stem: config.paths, **chosen}
    return {name: make_paths(paths) for name, paths in chosen.items()}


@lru_cache(maxsize=16)  # the noise of 1000 paths takes seconds; a config is all it depends on
def make_paths(config: PathConfig) -> PathSet:
    """Builds the paths of a config, each from the origin along x unless `placed`.

    Raises:
        ValueError: A number is out of range, the kind is unknown, or the file is not a path.
    """
    for name in ("count", "validation_count", "waypoints", "spacing", "room", "radius"):
        if not getattr(config, name) > 0:
            raise ValueError(f"paths: {name} is {getattr(config, name)}: must be above 0")
    for name in ("sharpest_radius", "straight", "straight_spacing"):
        if not getattr(config, name) >= 0:
            raise ValueError(f"paths: {name} is {getattr(config, name)}: must not be below 0")
    if 0 < config.straight_spacing < config.spacing:
        raise ValueError(
            f"paths: straight_spacing is {config.straight_spacing}: must not be below spacing, "
            f"{config.spacing}; 0 for the same everywhere"
        )
    paths = _from_origin(config)
    if config.mirrored:
        paths = joined_paths([paths, paths.mirrored()])
    if config.placed:
        place = np.random.default_rng(_seeds(config, "places", 1)).uniform(-1, 1, (len(paths), 3))
        half = _at_scale(config).room / 2
        scale = torch.tensor([half, half, math.pi], dtype=torch.float32)
        paths = paths.placed(torch.as_tensor(place).float() * scale)
    return paths


def _at_scale(config: PathConfig) -> PathConfig:
    """The paths with the lengths of their car; the config is in those of the buggy."""
    if not config.car:
        return config
    length = load_car(config.car).similarity.length
    return replace(config, **{name: length * getattr(config, name) for name in LENGTHS})


def _from_origin(config: PathConfig) -> PathSet:
    size = config.spacing
    config = _at_scale(config)
    size = config.spacing / size
    full, bend = 2 * math.pi * config.radius, 1 / config.radius
    spacing = config.spacing
    match config.kind:
        case "simplex":
            count = config.count if config.part == "training" else config.validation_count
            seeds = _seeds(config, "noise", count).tolist()
            shape = (config.waypoints, spacing, config.room, config.sharpest_radius)
            points = simplex_paths(seeds, *shape, config.straight_spacing)
            closed = False
            return equal_paths([f"{config.part} {i}" for i in range(count)], points, closed)
        case "tight":
            shape = (TIGHT_WAYPOINTS, spacing, size * TIGHT_ROOM, size * TIGHT_RADIUS)
            points, closed = simplex_paths([TIGHT_SEED], *shape), False
        case "lap":
            half = [(config.straight, 0.0), (full / 2, bend)]
            points, closed = along_arcs(2 * half, spacing)[None], True
        case "infinity":
            points, closed = along_arcs([(full, bend), (full, -bend)], spacing)[None], True
        case "circle":
            points, closed = along_arcs([(full, bend)], spacing)[None], True
        case "file":
            row, closed = read_points(Path(config.file), spacing)
            points = row[None]
        case _:
            raise ValueError(f"no path {config.kind!r}; available: {', '.join(get_args(Kind))}")
    name = Path(config.file).stem if config.kind == "file" else config.kind
    return equal_paths([name], points, closed)


def _seeds(config: PathConfig, purpose: Literal["noise", "places"], count: int) -> NDArray:
    """Seeds [count] < 2^63 of a stream of its own for each part and purpose."""
    stream = (get_args(Part).index(config.part), ("noise", "places").index(purpose))
    sequence = np.random.SeedSequence(config.seed, spawn_key=stream)
    return sequence.generate_state(count, np.uint64) >> np.uint64(1)
