"""A simulator's own parameters fitted to recordings, and simulators compared on others."""

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Any

import pandas as pd
import yaml
from tensordict import TensorDict
from torchrl.envs import EnvBase

from buggy_rl.api.drives import Drives, drives_of
from buggy_rl.core.config import from_python
from buggy_rl.core.files import write_atomically
from buggy_rl.estimation import least_squares
from buggy_rl.estimation.fit_result import Fit, as_simulator
from buggy_rl.estimation.least_squares import FitConfig
from buggy_rl.estimation.table import (
    ComparedSimulator,
    HeldOut,
    held_out_segments,
    rollout_errors,
    table_row,
)
from buggy_rl.recordings import Recording
from buggy_rl.simulators import ENGINES, Factory, as_car, make_engine, simulator_name
from buggy_rl.task.env import make_simulator


@dataclass(frozen=True, eq=False)
class FittedSimulator:
    """A simulator with fitted parameters, and what the fit is worth."""

    simulator: str
    """Simulator that was fitted: an engine's name, a .yaml or file.py:factory."""
    fit: Fit
    options: Mapping[str, Any] = field(default_factory=dict)
    """Options of the engine."""
    parameters: Mapping[str, float] = field(default_factory=dict)
    """Parameters that were given and are those of the simulator where they were not fitted."""

    @property
    def estimates(self) -> pd.DataFrame:
        """A row for each fitted parameter: value, 95 % interval, start, and warnings."""
        rows = [
            {
                "parameter": e.parameter.name,
                "value": e.value,
                "low": e.low,
                "high": e.high,
                "unit": e.parameter.unit,
                "started_from": e.parameter.value,
                "warnings": "; ".join(e.warnings),
            }
            for e in self.fit.estimates
        ]
        return pd.DataFrame(rows)

    @property
    def warnings(self) -> list[str]:
        """Why the fit should not be trusted; none for a sound fit."""
        return self.fit.warnings

    def make(self, batch_size: int | Sequence[int] = (), device: str = "cpu") -> EnvBase:
        """The fitted simulator.

        Args:
            batch_size: Number of environments or a shape.
            device: Where the state lives.
        """
        made = self.to_dict()["parameters"]
        return make_engine(self.simulator, batch_size, device, made, **self.options)

    def save(self, file: str | Path, question: Mapping[str, Any] | None = None) -> Path:
        """Writes a file that is taken wherever a simulator is named.

        Args:
            file: To be written, a .yaml.
            question: What the fit depends on, where it is to be known again.
        """
        write_atomically(Path(file), yaml.safe_dump(self.to_dict(question), sort_keys=False))
        return Path(file)

    def to_dict(self, question: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """The content of that file."""
        return as_simulator(self.simulator, self.fit, self.options, self.parameters, question)


def fit(
    recordings: Drives,
    simulator: str | Path = "mujoco",
    *,
    car: str = "",
    columns: str | Path | None = None,
    options: Mapping[str, Any] | None = None,
    **settings: Any,
) -> FittedSimulator:
    """Fits the parameters that a simulator declares, by least squares over windows of 1 s.

    Args:
        recordings: To fit to: recordings, or their paths.
        simulator: That declares parameters.
        car: Name or file of the car; empty for the buggy.
        columns: How tables are read.
        options: Further arguments of the simulator's class.
        settings: Fields of `FitConfig`: parameters, fixed, windows, iterations, and so on.

    Raises:
        ValueError: A setting is unknown, or the recordings cannot be used.
    """
    config = from_python(FitConfig, settings, "fit")
    drives = drives_of(recordings, warnings.warn, columns, car=car)
    name, made = str(simulator), {"options": {}, "parameters": {}}
    if car and name in ENGINES:  # a file says itself what it is
        made = as_car(name, car)
    return fitted_simulator(
        name, drives, config, {**made["options"], **(options or {})}, made["parameters"]
    )


def fitted_simulator(
    simulator: str,
    drives: Sequence[Recording],
    config: FitConfig,
    options: Mapping[str, Any],
    parameters: Mapping[str, float],
    show: Callable[[dict[str, float]], None] = lambda _: None,
) -> FittedSimulator:
    """The fit that is asked of Python and of the command line.

    Args:
        simulator: That declares parameters.
        drives: To fit to.
        config: How.
        options: Of the simulator.
        parameters: Of the simulator, where it starts from others than its own.
        show: Told of every iteration.
    """
    make = cache(
        lambda count: make_engine(simulator, count, parameters=parameters or None, **options)
    )
    found = least_squares.least_squares_fit(make, drives, config, show)
    return FittedSimulator(simulator, found, options, parameters)


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
        simulator, position_mse_1s [m^2] with its 95 % interval (low, high), position_median_1s [m],
        and for each horizon errors in position [m], yaw [rad] and velocities.

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
