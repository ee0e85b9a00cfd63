"""The original study's tables 7.2 to 7.7: policies in simulators and on the car."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from statistics import mean, stdev
from typing import Any

import torch
from omegaconf import MISSING
from scipy.stats import t as student_t
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from buggy_rl.core.longitudinal import LongitudinalCommand
from buggy_rl.policies.closed_loop import Driver, Scores, drive
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
from buggy_rl.policies.human_table import HumanDrives, human_lines
from buggy_rl.policies.training.actor_critic import load_policy
from buggy_rl.policies.training.run import EngineConfig, new_engine
from buggy_rl.task.config import TaskConfig
from buggy_rl.task.env import make_env, make_simulator
from buggy_rl.task.paths.making import make_paths

ORIGINAL: dict[str, dict[str, dict[str, str]]] = {  # printed; place -> path set -> policy
    "learned": {
        "training": {"learned": "88.2 ± 21.2", "mujoco": "34.9 ± 21.9"},
        "validation": {"learned": "59.7 ± 27.0", "mujoco": "18.9 ± 22.0"},
    },
    "mujoco": {
        "training": {"learned": "67.2 ± 29.0", "mujoco": "81.5 ± 29.9"},
        "validation": {"learned": "52.0 ± 16.6", "mujoco": "78.7 ± 25.3"},
    },
    "own simulator": {
        "lap": {"learned": "87", "mujoco": "106"},
        "infinity": {"learned": "75", "mujoco": "72"},
        "random": {"learned": "36", "mujoco": "22"},
    },
    "car": {
        "lap": {"learned": "60.0 ± 16.4", "mujoco": "47.3 ± 14.3"},
        "infinity": {"learned": "64.4 ± 10.8", "mujoco": "42.2 ± 8.7"},
        "random": {"learned": "31.6 ± 4.6", "mujoco": "11.5 ± 1.5"},
    },
    "lost": {"mean": {"learned": "13.66", "mujoco": "33.02"}},
}


@dataclass(frozen=True)
class PolicyTablesConfig:
    """Which policies drive where."""

    output: str = MISSING
    """Folder for policies.md and policies.csv."""
    policies: dict[str, list[str]] = field(default_factory=dict)
    """Name of a kind -> its policy files, one a seed; `learned` and `mujoco` as in the original."""
    simulators: dict[str, str] = field(default_factory=dict)
    """The simulator that each kind was trained in, under the same names."""
    car: str = "reference"
    """What stands for the real car; neither kind was trained on it."""
    car_drives: int = 5
    """Drives of each policy on the car, which differ by the camera's noise."""
    task: TaskConfig = field(default_factory=TaskConfig)
    """The task, as in training; its paths are replaced by those of the tables."""
    random_paths: int = 10
    """Training paths that policies are judged on; the validation paths are all driven."""
    human: str = ""
    """Folder of drives by people, of scripts/drive.py; empty for none."""
    threads: int = 1
    """Threads of PyTorch."""


@dataclass(frozen=True)
class Result:
    """One kind of policy in one place on one set of paths."""

    policy: str
    place: str
    course: str
    scores: Scores
    """Scores of all its drives; [seeds * drives]."""
    seeds: tuple[float, ...]
    """Mean waypoints of each seed."""


def mean_interval(values: Sequence[float]) -> tuple[float, float]:
    """95 % interval of the mean of independent values, by Student's t; nan for a single one."""
    count = len(values)
    if count < 2:
        return float("nan"), float("nan")
    half = float(student_t.ppf(0.975, count - 1)) * stdev(values) / count**0.5
    return mean(values) - half, mean(values) + half


def policy_results(
    config: PolicyTablesConfig, progress: Callable[[Sequence], Iterable] = list
) -> Iterator[Result]:
    """Drives every policy in every simulator, and on the car."""
    places = {**config.simulators, "car": config.car}
    everything = [
        (kind, place, course)
        for kind in config.policies
        for place in places
        for course in benchmark_paths(config.task.paths, config.random_paths)
        # The original drove random paths in simulators only: they do not fit in a room.
        if place != "car" or course not in ("training", "validation")
    ]
    for kind, place, course in progress(everything):
        parts = [
            _drives(config, places[place], place == "car", course, load_policy(file)[0].driver())
            for file in config.policies[kind]
        ]
        seeds = tuple(part.waypoints.mean().item() for part in parts)
        yield Result(kind, place, course, _joined(parts), seeds)


def _drives(
    config: PolicyTablesConfig, simulator: str, on_the_car: bool, name: str, driver: Driver
) -> Scores:
    course = benchmark_paths(config.task.paths, config.random_paths)[name]
    many = {"training": config.random_paths, "validation": course.paths.validation_count}
    cars = many.get(name, config.car_drives if on_the_car else 1)
    task = replace(evaluation_task(config.task, course.steps, on_the_car), paths=course.paths)
    with torch.random.fork_rng():
        torch.manual_seed(0)
        return drive(make_env(make_simulator(simulator, cars), task=task), driver, course.steps)


def _joined(parts: Sequence[Scores]) -> Scores:
    return Scores(**{name: torch.cat([getattr(p, name) for p in parts]) for name in vars(parts[0])})


def tables(found: Sequence[Result], car: str, human: HumanDrives | None = None) -> str:
    """Tables 7.2 to 7.7 as Markdown, ours beside the original's printed numbers.

    `car` is what the car's column is called, such as "reference car"; `human` are
    a person's drives.
    """
    closed = {(r.policy, r.place, r.course): r.scores.waypoints for r in found}
    kinds = list(dict.fromkeys(r.policy for r in found))
    room = ("lap", "infinity", "random")

    def cell(kind: str, place: str, course: str, printed_in: str) -> str:
        values, printed = closed[kind, place, course], _printed(printed_in, course, kind)
        return f"{values.mean():.1f} ± {values.std(correction=0):.1f} ({printed})"

    lines = [
        "Waypoints closed, mean ± sd over drives and seeds; in brackets the original study's "
        "printed figures. The last table has the 95 % interval of the mean over seeds."
    ]
    for number, course in (("7.2", "training"), ("7.3", "validation")):
        lines += _heading(f"Table {number}: ten {course} paths, 1000 steps", "driven in", kinds)
        lines += [_row(at, [cell(k, at, course, at) for k in kinds]) for at in kinds]
    lines += human_lines(human or HumanDrives(), kinds)
    lines += _heading("Table 7.5: each policy in its own simulator", "path", kinds)
    lines += [_row(c, [cell(k, k, c, "own simulator") for k in kinds]) for c in room]
    lines += _heading(f"Table 7.6: on the {car}", "path", kinds)
    lines += [_row(c, [cell(k, "car", c, "car") for k in kinds]) for c in room]
    lines += _heading(f"Table 7.7: waypoints lost from simulator to {car}", "path", kinds)
    lost = {k: [_lost(closed, k, course) for course in room] for k in kinds}
    lines += [_row(c, [f"{lost[k][i]:.1f}" for k in kinds]) for i, c in enumerate(room)]
    mean = [f"{sum(lost[k]) / 3:.1f} ({_printed('lost', 'mean', k)})" for k in kinds]
    return "\n".join([*lines, _row("mean", mean), "", *_details(found)]) + "\n"


def _lost(closed: Mapping[tuple[str, str, str], Tensor], kind: str, course: str) -> float:
    return (closed[kind, kind, course].mean() - closed[kind, "car", course].mean()).item()


def _printed(place: str, course: str, kind: str) -> str:
    return ORIGINAL.get(place, {}).get(course, {}).get(kind, "-")


def _heading(title: str, first: str, kinds: Sequence[str]) -> list[str]:
    columns = _row(first, [f"policy from {kind}" for kind in kinds])
    return ["", f"{title}:", "", columns, "|---|" + "---|" * len(kinds)]


def _row(name: str, cells: Sequence[str]) -> str:
    return f"| {name} | {' | '.join(cells)} |"


def _details(found: Sequence[Result]) -> list[str]:
    lines = [
        "How they drove:",
        "",
        "| policy from | in | path | waypoints | interval | kept on | lateral mean / RMS / max [m]"
        " | heading [rad] | speed [m/s] | steering effort | out of range |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for r in found:
        m = r.scores.means()
        lateral = f"{m['lateral_mean']:.3f} / {m['lateral_rms']:.3f} / {m['lateral_max']:.3f}"
        outside = "-" if m["out_of_range"] != m["out_of_range"] else f"{m['out_of_range']:.1%}"
        lines.append(
            f"| {r.policy} | {r.place} | {r.course} | {m['waypoints']:.1f}"
            f" | {_range(mean_interval(r.seeds))} | {m['kept_on']:.0%}"
            f" | {lateral} | {m['heading_mean']:.3f} | {m['speed']:.2f}"
            f" | {m['steering_effort']:.3f} | {outside} |"
        )
    return lines


def _range(interval: tuple[float, float]) -> str:
    return "-" if interval[0] != interval[0] else f"{interval[0]:.1f} .. {interval[1]:.1f}"


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
