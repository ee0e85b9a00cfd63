"""Simulators compared on recordings that none of them was made from."""

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path

import pandas as pd
from tensordict import TensorDict

from buggy_rl.api.drives import Drives, drives_of
from buggy_rl.estimation.table import (
    ComparedSimulator,
    HeldOut,
    held_out_segments,
    rollout_errors,
    table_row,
)
from buggy_rl.simulators import Factory, simulator_name
from buggy_rl.task.env import make_simulator

Row = dict[str, float | str]


def evaluate(
    simulators: Mapping[str, str | Path | Factory] | str | Path | Factory,
    recordings: Drives,
    *,
    windows: int = 300,
    columns: str | Path | None = None,
    car: str = "",
) -> pd.DataFrame:
    """Errors of open-loop rollouts after 0.3, 1 and 3 s, a row for each simulator.

    Args:
        simulators: By a name for the table, or a single one.
        recordings: That no simulator was fitted to or trained on: recordings, or their paths.
        windows: Most rollouts, spread evenly over the recordings; at least 2.
        columns: How tables are read.
        car: Name or file of the car, whose limits hold for the recordings.

    Returns:
        simulator, position_mse_1s [m^2] with its 95 % interval (low, high), and for each horizon
        errors in position [m], yaw [rad] and velocities.

    Raises:
        ValueError: The recordings cannot be used, or a simulator cannot be made.
    """
    if not isinstance(simulators, Mapping):
        simulators = {simulator_name(simulators): simulators}
    drives = drives_of(recordings, warnings.warn, columns, car=car)
    test = held_out_segments(drives, windows)
    named = [ComparedSimulator(name, partial(make_simulator, s)) for name, s in simulators.items()]
    return pd.DataFrame([row for row, _ in judged_simulators(named, test)])


def judged_simulators(
    candidates: Iterable[ComparedSimulator],
    test: HeldOut,
    show: Callable[[str], None] = lambda _: None,
) -> Iterator[tuple[Row, TensorDict]]:
    """The table's row and the rollouts of each simulator.

    Args:
        candidates: The simulators.
        test: Segments that they are rolled out along.
        show: Told whose turn it is.
    """
    for candidate in candidates:
        show(candidate.name)
        made, error = rollout_errors(candidate, test)
        yield table_row(candidate.name, error, test.segments.length_blocks()), made
