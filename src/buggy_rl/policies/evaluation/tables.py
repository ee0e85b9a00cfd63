"""The original study's tables 7.2 to 7.7: policies in simulators and on the car."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from statistics import mean, stdev

import torch
from omegaconf import MISSING
from scipy.stats import binomtest
from scipy.stats import t as student_t
from torch import Tensor

from buggy_rl.policies.closed_loop import Driver, Scores, drive
from buggy_rl.policies.evaluation.drives import benchmark_paths, evaluation_task
from buggy_rl.policies.human_table import HumanDrives, human_lines
from buggy_rl.policies.training.actor_critic import load_policy
from buggy_rl.task.config import TaskConfig
from buggy_rl.task.env import make_env, make_simulator

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
    failed: tuple[bool, ...]
    """Whether a seed's policy spun or left its path in any of its drives."""


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
        failed = tuple(bool(((p.spun > 0) | (p.kept_on < 1)).any()) for p in parts)
        yield Result(kind, place, course, _joined(parts), seeds, failed)


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
    lines += [_row("mean", mean), *_failures(found, car, kinds, room), "", *_details(found)]
    return "\n".join(lines) + "\n"


def share_interval(failed: Sequence[bool]) -> tuple[float, float]:
    """95 % interval (Clopper-Pearson) of the probability that a seed's policy fails."""
    interval = binomtest(sum(failed), len(failed)).proportion_ci()
    return float(interval.low), float(interval.high)


def _failures(
    found: Sequence[Result], car: str, kinds: Sequence[str], room: Sequence[str]
) -> list[str]:
    failed = {(r.policy, r.place, r.course): r.failed for r in found}

    def cell(seeds: Sequence[bool]) -> str:
        low, high = share_interval(seeds)
        return f"{sum(seeds)} of {len(seeds)} ({low:.0%} to {high:.0%})"

    lines = _heading(
        f"Policies that spin or leave their path on the {car}, and 95 % interval of the share",
        "path",
        kinds,
    )
    lines += [_row(c, [cell(failed[k, "car", c]) for k in kinds]) for c in room]
    any_path = [
        cell([any(each) for each in zip(*(failed[k, "car", c] for c in room), strict=True)])
        for k in kinds
    ]
    return [*lines, _row("any of them", any_path)]


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
