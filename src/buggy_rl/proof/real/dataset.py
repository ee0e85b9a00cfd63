"""Untouched recordings of one car, in halves of which one is edited and the other is not."""

import random
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import MISSING

from buggy_rl.core import keys
from buggy_rl.recordings import Recording, load_recordings

COPIED = 0.01  # share of rows in common from which one recording is a copy of a part of another
SIDES = "ab"
SEEDS = 50  # of divisions, until as many differ as are asked for


@dataclass(frozen=True)
class DatasetConfig:
    """Recordings of one car that was left as it was."""

    recordings: list[str] = MISSING
    """Files and folders."""
    columns: str = ""
    """YAML column map."""
    car: str = MISSING
    """The car: a name in configs/cars or a file."""
    leave_out: list[str] = field(default_factory=list)
    """Names of recordings in which something about the car or the floor is another."""
    fits: dict[str, list[str]] = field(default_factory=dict)
    """Engine -> options of the script that makes the simulator from a half."""
    weight: int = 1
    """How often it is drawn."""


@dataclass(frozen=True, eq=False)
class Dataset:
    """Recordings that were read and compared."""

    name: str
    config: DatasetConfig
    recordings: list[Recording]
    _halves: dict[str, list[Recording]] = field(default_factory=dict, init=False, repr=False)

    def half(self, name: str) -> list[Recording]:
        """The recordings of a half, such as `0a`."""
        if name not in self._halves:
            made = halves(self.recordings, int(name[:-1]))
            self._halves.update({f"{name[:-1]}{side}": own for side, own in made.items()})
        return self._halves[name]

    @property
    def kind(self) -> str:
        """Kind of the first command."""
        return self.recordings[0].command.kind


def load_dataset(name: str, config: DatasetConfig) -> Dataset:
    """Reads recordings, without those that are left out.

    Raises:
        ValueError: One is refused, a name that is left out is not there, or two share rows.
    """
    found, refusals = load_recordings(config.recordings, config.columns or None, car=config.car)
    if refusals:
        raise ValueError(f"datasets.{name}: {refusals[0]}")
    names = {recording.name for recording in found}
    if missing := sorted(set(config.leave_out) - names):
        raise ValueError(
            f"datasets.{name}.leave_out: no recordings {missing}; there are {sorted(names)}"
        )
    kept = [recording for recording in found if recording.name not in config.leave_out]
    refuse_copies(kept)
    return Dataset(name, config, kept)


def load_datasets(configs: Mapping[str, DatasetConfig]) -> dict[str, Dataset]:
    """The datasets of a run, by name; errors as of `load_dataset`."""
    return {name: load_dataset(name, config) for name, config in configs.items()}


def refuse_copies(recordings: Sequence[Recording]) -> None:
    """Compares recordings by the content of their rows, whatever their names and stamps.

    Raises:
        ValueError: Two have rows in common; the message says how many.
    """
    poses = [_distinct(recording) for recording in recordings]
    for one, other in combinations(range(len(recordings)), 2):
        common = len(poses[one] & poses[other])
        fewer = min(len(poses[one]), len(poses[other]))
        if common > COPIED * fewer:
            raise ValueError(
                f"recordings {recordings[one].source} and {recordings[other].source} have {common} "
                f"of {fewer} rows in common: what was seen in one is not unseen in the other; "
                "leave one of them out"
            )


def _distinct(recording: Recording) -> set[bytes]:
    """The poses of a recording while the car moves; at rest two may be alike by chance."""
    speed = recording.data[keys.VELOCITY][:, :2].norm(dim=-1).numpy()
    pose = recording.data[keys.POSE].numpy()[speed > 0.1]
    return {row.tobytes() for row in np.ascontiguousarray(pose)}


def halves(recordings: Sequence[Recording], partition: int) -> dict[str, list[Recording]]:
    """Side -> recordings; each kind of drive, by its folder, is on both sides where it can be.

    Args:
        recordings: All of them.
        partition: Number of the division; no two divisions are the same.

    Raises:
        ValueError: So many divisions were not found.
    """
    divisions: dict[frozenset, dict[str, list[Recording]]] = {}
    for seed in range(SEEDS):
        sides = _divided(recordings, random.Random(f"halves {seed}"))
        key = frozenset(frozenset(r.name for r in side) for side in sides.values())
        divisions.setdefault(key, sides)
        if len(divisions) > partition:
            return list(divisions.values())[partition]
    raise ValueError(
        f"{len(recordings)} recordings can be divided in {len(divisions)} ways, not in "
        f"{partition + 1}: use a smaller draw.partitions"
    )


def _divided(recordings: Sequence[Recording], chance: random.Random) -> dict[str, list[Recording]]:
    kinds: dict[str, list[Recording]] = {}
    for recording in sorted(recordings, key=lambda r: r.name):
        kinds.setdefault(str(Path(recording.source).parent), []).append(recording)
    found: dict[str, list[Recording]] = {side: [] for side in SIDES}
    for kind in sorted(kinds):
        own: dict[str, int] = dict.fromkeys(SIDES, 0)
        for recording in chance.sample(kinds[kind], len(kinds[kind])):
            # Fewest of its kind, then shortest in all, then by chance.
            order = sorted(chance.sample(SIDES, 2), key=lambda s: (own[s], _seconds(found[s])))
            found[order[0]].append(recording)
            own[order[0]] += 1
    return found


def _seconds(recordings: Sequence[Recording]) -> float:
    return sum(recording.duration for recording in recordings)


def cut_pieces(recordings: Sequence[Recording], seconds: float) -> Iterator[Recording]:
    """Yields recordings cut into pieces no longer than so many seconds, numbered."""
    number = 0
    for recording in recordings:
        count = max(1, -(-len(recording) // round(seconds / recording.dt)))
        for rows in np.array_split(np.arange(len(recording)), count):
            data: Any = recording.data[int(rows[0]) : int(rows[-1]) + 1].clone()
            yield Recording(f"piece_{number:03d}", data, recording.dt, command=recording.command)
            number += 1
