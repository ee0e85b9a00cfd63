"""Controllers tuned for a simulator, and the table of how they drive there."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from omegaconf import MISSING
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from buggy_rl.core.longitudinal import LongitudinalCommand
from buggy_rl.policies.closed_loop import Scores, drive
from buggy_rl.policies.controllers.at_scale import for_car, taken_by
from buggy_rl.policies.controllers.path_tracking import (
    PurePursuit,
    PurePursuitConfig,
    Stanley,
    StanleyConfig,
)
from buggy_rl.policies.controllers.replay import RandomDriver
from buggy_rl.policies.controllers.tuning import Trial, TuningConfig, tune
from buggy_rl.policies.evaluation.drives import STEPS, Benchmark, benchmark_paths, evaluation_task
from buggy_rl.policies.training.run import EngineConfig, new_engine
from buggy_rl.task.config import TaskConfig
from buggy_rl.task.env import make_env
from buggy_rl.task.paths.making import make_paths

DRIVERS: dict[
    str, tuple[Callable[[Any, LongitudinalCommand], TensorDictModuleBase], Callable[[], Any]]
] = {
    "pure_pursuit": (PurePursuit, PurePursuitConfig),
    "stanley": (Stanley, StanleyConfig),
}


@dataclass(frozen=True)
class DriverTablesConfig:
    """Controllers, the simulator they are tuned for, and the extent of the search."""

    output: str = MISSING
    """Folder for the tuned numbers, drivers.md and drivers.csv."""
    engine: EngineConfig = field(default_factory=EngineConfig)
    task: TaskConfig = field(default_factory=TaskConfig)
    drivers: list[str] = field(default_factory=lambda: list(DRIVERS))
    """Controllers to tune, of pure_pursuit, stanley."""
    tuning_paths: int = 16
    """Training paths that every candidate is scored on."""
    candidates: int = 96
    """Sets of numbers tried in a round, each by a car on every path."""
    rounds: int = 5
    """Rounds of the search, each nearer to the best so far."""
    steps: int = STEPS
    """Steps of each drive of the search."""
    lateral_limit: float = 0.15
    """RMS distance from the path that the best may have [m]."""
    range_limit: float = 0.05
    """Share of steps that the best may be outside what a learned simulator was trained on."""
    random_paths: int = 10
    """Training paths that the tuned controllers are scored on, beside all validation paths."""
    seed: int = 0
    """Seed of the search."""
    threads: int = 1
    """Threads of PyTorch."""


def tuned_driver(
    config: DriverTablesConfig, name: str, step: Callable[[], object]
) -> tuple[Any, list[Trial]]:
    """Searches the numbers of a controller that close most waypoints on the training paths.

    Calls `step` at every step.

    Returns:
        The best numbers, and all that were tried, best first.

    Raises:
        ValueError: There is no such controller.
    """
    if name not in DRIVERS:
        raise ValueError(f"no controller {name!r} to tune; available: {', '.join(DRIVERS)}")
    make, default = DRIVERS[name]
    course = benchmark_paths(config.task.paths, config.tuning_paths)["training"]
    env = _course_env(config, replace(course, steps=config.steps), config.candidates)

    def watched(numbers: Any) -> Any:
        driver = for_car(partial(make, numbers), config.task.paths.car, taken_by(env))

        def driven(state: TensorDictBase) -> TensorDictBase:
            step()
            return driver(state)

        return driven

    limits = config.lateral_limit, config.range_limit
    search = TuningConfig(config.steps, config.rounds, *limits, config.seed)
    return tune(env, config.tuning_paths, watched, default(), search)


@dataclass(frozen=True)
class DriverResult:
    """One controller on one set of paths."""

    driver: str
    course: str
    scores: Scores

    def row(self) -> dict[str, float | str]:
        """Row of a table, means over the paths."""
        return {"driver": self.driver, "course": self.course, **self.scores.means()}


def driver_results(
    config: DriverTablesConfig, found: dict[str, Any], progress: Callable[[Sequence], Any] = list
) -> Iterator[DriverResult]:
    """Scores each tuned controller, by its numbers, and a random one on every set of paths."""
    named = benchmark_paths(config.task.paths, config.random_paths)
    for name, course in progress([(n, c) for n in (*found, "random") for c in named]):
        env = _course_env(config, named[course])
        if name in found:
            make = partial(DRIVERS[name][0], found[name])
            driver = for_car(make, config.task.paths.car, taken_by(env))
        else:
            driver = RandomDriver(seed=config.seed)
        yield DriverResult(name, course, drive(env, driver, named[course].steps))


def _course_env(config: DriverTablesConfig, course: Benchmark, each: int = 1):
    """`each` environments on each path of a benchmark; the paths in turn."""
    paths = make_paths(course.paths)
    task = evaluation_task(config.task, course.steps)
    return make_env(new_engine(config.engine, each * len(paths)), task=task, paths=paths)


def driver_table(
    rows: Sequence[DriverResult], best: Mapping[str, Trial], config: DriverTablesConfig
) -> str:
    """Markdown of the scores and of the numbers of each tuned controller."""
    lines = [
        f"Drivers of {config.engine.simulator}, tuned on {config.tuning_paths} training paths for "
        f"most waypoints at an RMS error of at most {config.lateral_limit} m"
        f" and at most {config.range_limit:.0%} of the steps out of range.",
        "",
        "| driver | path | waypoints | kept on | lateral mean / RMS / max [m] | heading [rad]"
        " | speed [m/s] | steering effort | out of range |",
        "|---|---|--:|--:|---|--:|--:|--:|--:|",
    ]
    lines += map(_line, rows)
    for name, trial in best.items():
        numbers = ", ".join(f"{key} {value:.3f}" for key, value in trial.values.items())
        lines += [
            "",
            f"{name}: {trial.waypoints:.1f} waypoints at {trial.lateral_rms:.3f} m RMS on the "
            f"tuning paths with {numbers}.",
        ]
    return "\n".join(lines) + "\n"


def _line(result: DriverResult) -> str:
    m = result.scores.means()
    lateral = f"{m['lateral_mean']:.3f} / {m['lateral_rms']:.3f} / {m['lateral_max']:.2f}"
    known = m["out_of_range"] == m["out_of_range"]
    outside = f"{m['out_of_range']:.1%}" if known else "-"
    return (
        f"| {result.driver} | {result.course} | {m['waypoints']:.1f} | {m['kept_on']:.0%}"
        f" | {lateral} | {m['heading_mean']:.3f} | {m['speed']:.2f}"
        f" | {m['steering_effort']:.3f} | {outside} |"
    )
