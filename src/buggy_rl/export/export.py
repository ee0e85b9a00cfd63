"""Makes the files of the car from best.pt, once runtime and training were seen to agree."""

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from omegaconf import MISSING

from buggy_rl.car.path import Path as CarPath
from buggy_rl.car.policy import Policy as Runtime
from buggy_rl.core.config import from_plain
from buggy_rl.core.longitudinal import declared_by
from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.export.parity import Parity, parity_task, scattered
from buggy_rl.export.translation import runtime_task
from buggy_rl.export.writing import (
    arrays,
    move_into_place,
    settings,
    write_onnx,
    write_pair,
    write_path,
)
from buggy_rl.policies.evaluation.drives import STEPS, Benchmark, benchmark_paths
from buggy_rl.policies.training.actor_critic import Policy, load_policy
from buggy_rl.policies.training.run import PolicyRunConfig, new_engine, task_of, training_engine
from buggy_rl.simulators.base import HoldEngine
from buggy_rl.task.config import TaskConfig, TransformConfig
from buggy_rl.task.env import make_env
from buggy_rl.task.paths.making import PathConfig, make_paths
from buggy_rl.task.paths.path_set import PathSet


@dataclass(frozen=True)
class ExportConfig:
    """A policy for the car's computer."""

    policy: str = MISSING
    """best.pt or last.pt of scripts/train_policy.py."""
    output: str = MISSING
    """Common part of the files: OUTPUT.npz, OUTPUT.json, OUTPUT.onnx."""
    course: list[str] = field(default_factory=lambda: ["lap", "infinity"])
    """Paths written beside them as CSV: lap, infinity, random, or a .csv with columns x, y [m]."""
    training_only: list[str] = field(default_factory=list)
    """Places of the task with transforms of your own that change neither observation nor command;
    they stay in the comparison."""
    tolerance: float = 1e-5
    """Largest difference between the car's runtime and training, in the unit of each number."""
    random_steps: int = 1000
    """Steps on random poses and velocities that are compared."""
    seed: int = 0
    """Seed of the random steps."""
    threads: int = 1
    """Threads of PyTorch."""

    def __post_init__(self) -> None:
        if not 0 < self.tolerance <= 1e-3:
            raise ValueError(f"tolerance={self.tolerance:g}: must be in (0, 1e-3]")
        if self.random_steps < 1:
            raise ValueError(f"random_steps={self.random_steps}: must be at least 1")


ALWAYS = ("lap", "infinity")  # courses that every policy is compared on
OWN_NAMES = ("lap", "infinity", "random")


@dataclass(frozen=True)
class ExportPath:
    """A path to follow, and the steps of an episode on it."""

    name: str
    paths: PathSet
    steps: int

    @property
    def for_car(self) -> CarPath:
        """The path in the runtime's form."""
        count = int(self.paths.count[0])
        return CarPath(self.paths.points[0, :count].numpy(), bool(self.paths.closed[0]), self.name)


class Export:
    """A policy on its way to the car.

    Args:
        config: Of the export.

    Raises:
        ValueError: There is no such policy or course, or the car's runtime does not know a part of
            the policy's task.
    """

    def __init__(self, config: ExportConfig) -> None:
        self.config, file = config, Path(config.policy)
        self.policy, about = load_policy(file)
        run = from_plain(PolicyRunConfig, about["config"], str(file))
        self.run = replace(run, engine=training_engine(about, file), task=task_of(about, file))
        self.courses = [_course(name, self.run.task.paths) for name in config.course]
        compared = {course.name: course for course in self.courses}
        self.compared = {name: _course(name, self.run.task.paths) for name in ALWAYS} | compared
        engine = new_engine(self.run.engine, 1)
        dt = getattr(engine, "dt", CONTROL_PERIOD)
        any_paths = self.courses[0].paths if self.courses else self.compared["lap"].paths
        task = runtime_task(self.run.task, any_paths, dt, config.training_only)
        self.command = declared_by(engine)
        self.settings = settings(self.policy, about, file, task, self.command.two_way)
        self.dt = dt

    def comparisons(self, runtime: Runtime) -> Iterator[tuple[str, dict[str, float]]]:
        """Compares the runtime with training; yields what was compared and how far it differed.

        Raises:
            ParityError: It differs by more than the tolerance.
        """
        for course in self.compared.values():
            engine = new_engine(self.run.engine, 1)
            env = self._env(engine, course, self.run.task)
            yield course.name, self._comparison(runtime, env, course, course.name).run(course.steps)
        course, steps = self.compared[ALWAYS[0]], self.config.random_steps
        still = HoldEngine(1, dt=self.dt)
        still.command = self.command  # filters of commands begin at its rest
        env = self._env(still, course, self._known())
        random = self._comparison(runtime, env, course, "random inputs")
        yield "random inputs", random.run(steps, scattered(course.for_car, self.config.seed))

    def write(self, folder: Path) -> Path:
        """Writes all files into a folder; returns the root of the pair's names."""
        root = folder / Path(self.config.output).name
        write_pair(root, self.settings, arrays(self.policy))
        write_onnx(root.with_name(root.name + ".onnx"), self.policy)
        for course in self.courses:
            write_path(folder / f"{course.name}.csv", course.for_car)
        return root

    def _known(self) -> TaskConfig:
        """The task without transforms of the user's own, which may need their simulator."""
        places = {
            place: TransformConfig() if place in self.config.training_only else config
            for place, config in self.run.task.transforms.items()
        }
        return replace(self.run.task, transforms=places)

    def _env(self, engine: Any, course: ExportPath, task: TaskConfig) -> Any:
        env = make_env(engine, task=parity_task(task, course.steps), paths=course.paths)
        env.set_seed(self.config.seed)
        return env

    def _comparison(self, runtime: Runtime, env: Any, course: ExportPath, where: str) -> Parity:
        return Parity(runtime, self.policy, env, course.for_car, where, self.config.tolerance)


def export(config: ExportConfig) -> Iterator[tuple[str, Any]]:
    """Exports a policy; yields each comparison as it is done, then `("files", [Path, ...])`.

    The files are written elsewhere, read back by the car's runtime, compared, and only then put
    in place.

    Raises:
        ValueError: A part of the policy's task is unknown to the runtime.
        ParityError: Runtime and training differ; nothing was written.
    """
    task = Export(config)
    with tempfile.TemporaryDirectory() as folder, torch.no_grad():
        root = task.write(Path(folder))
        runtime, parity = Runtime.load(str(root)), {}
        for where, largest in task.comparisons(runtime):
            parity[where] = largest
            yield where, largest
        parity["onnx"] = onnx_difference(root.with_name(root.name + ".onnx"), task.policy)
        yield "onnx", {"command": parity["onnx"]}
        write_pair(root, {**task.settings, "parity": parity}, arrays(task.policy))
        yield "files", move_into_place(Path(folder), Path(config.output).parent)


def onnx_difference(file: Path, policy: Policy, rows: int = 256) -> float | str:
    """Largest difference between the ONNX model and the network on random observations.

    A text says so where onnxruntime is not installed.
    """
    try:
        import onnxruntime
    except ImportError:
        return "not compared: onnxruntime is not installed"
    session = onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])
    with torch.random.fork_rng():
        torch.manual_seed(0)
        observation = 3 * torch.randn(rows, policy.observation_size)
    (theirs,) = session.run(["command"], {"observation": observation.numpy()})
    mine = policy.mean_layers(policy.scaling(observation))
    return float((mine - torch.as_tensor(theirs)).abs().max())


def _course(name: str, paths: PathConfig) -> ExportPath:
    """A benchmark path by name, or one's own from a file."""
    if name.endswith(".csv"):
        plain = replace(paths, kind="file", file=name, placed=False, mirrored=False)
        chosen = Benchmark(plain, STEPS)
    elif name in OWN_NAMES:
        chosen = benchmark_paths(paths, 1)[name]
    else:
        raise ValueError(f"course={name!r}: must be one of {', '.join(OWN_NAMES)}, or a .csv file")
    return ExportPath(Path(name).stem, make_paths(chosen.paths).select([0]), chosen.steps)
