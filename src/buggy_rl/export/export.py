"""Makes the files of the car from best.pt, once runtime and training were seen to agree."""

import hashlib
import json
import shutil
import tempfile
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from omegaconf import MISSING
from torch import nn

from buggy_rl.car.path import Path as CarPath
from buggy_rl.car.path import path_lines
from buggy_rl.car.policy import Policy as Runtime
from buggy_rl.car.policy_file import SCHEMA
from buggy_rl.core.config import from_plain
from buggy_rl.core.files import replacing, write_atomically, write_json
from buggy_rl.core.longitudinal import declared_by
from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.export.parity import Parity, parity_task, scattered
from buggy_rl.export.translation import runtime_task
from buggy_rl.policies.evaluation.drives import STEPS, Benchmark, benchmark_paths
from buggy_rl.policies.training.actor_critic import OBSERVATION_LIMIT, Policy, Scaling, load_policy
from buggy_rl.policies.training.run import PolicyRunConfig, new_engine, task_of, training_engine
from buggy_rl.simulators.base import HoldEngine
from buggy_rl.task.config import TaskConfig, TransformConfig
from buggy_rl.task.env import make_env
from buggy_rl.task.paths.making import PathConfig, make_paths
from buggy_rl.task.paths.path_set import PathSet

OPSET = 11  # of ONNX: what the ONNX runtimes of 2019 and later load
ACTION_MAP = {
    "throttle": {"low": -1.0, "high": 1.0, "meaning": "-1 is no drive, 1 is full drive"},
    "steering": {"low": -1.0, "high": 1.0, "meaning": "1 is full left"},
}
TWO_WAY_THROTTLE = "0 is no drive, 1 is full drive, -1 is full brake or reverse"


def arrays(policy: Policy) -> dict[str, NDArray]:
    """The actor's numbers, float32: weight_i [out, in], bias_i [out], mean and sd [in]."""
    layers = [layer for layer in policy.mean_layers if isinstance(layer, nn.Linear)]
    content = {}
    for index, layer in enumerate(layers):
        content[f"weight_{index}"] = layer.weight.numpy()
        content[f"bias_{index}"] = layer.bias.numpy()
    if isinstance(policy.scaling, Scaling):
        content["mean"] = policy.scaling.mean.numpy()
        content["sd"] = policy.scaling.sd.numpy()
    return content


def settings(
    policy: Policy, about: dict[str, Any], file: Path, task: dict[str, Any], two_way: bool = False
) -> dict:
    """The JSON beside the numbers."""
    config, action = policy.config, ACTION_MAP
    if two_way:
        action = {**action, "throttle": {**action["throttle"], "meaning": TWO_WAY_THROTTLE}}
    return {
        "schema": SCHEMA,
        "buggy_rl": version("buggy_rl"),
        "training": _training(about, file),
        **task,
        "network": {
            "hidden": list(config.hidden),
            "activation": config.activation,
            "observation_limit": OBSERVATION_LIMIT,
        },
        "action": action,
        **({"two_way": True} if two_way else {}),
    }


def _training(about: dict[str, Any], file: Path) -> dict[str, Any]:
    config = about["config"]
    canonical = json.dumps(config, sort_keys=True).encode()
    note = file.parent / "run.json"
    run = json.loads(note.read_text()) if note.is_file() else {}
    return {
        "policy": file.name,
        "policy_sha256": hashlib.sha256(file.read_bytes()).hexdigest(),
        "config_sha256": hashlib.sha256(canonical).hexdigest(),
        "commit": run.get("commit", f"unknown: there is no run.json beside {file.name}"),
        "simulator": config["engine"]["simulator"],
        "seed": config["seed"],
        "steps": about.get("steps"),
    }


def write_pair(root: Path, settings: dict[str, Any], content: dict[str, NDArray]) -> None:
    """Writes ROOT.npz and ROOT.json."""
    with replacing(root.with_name(root.name + ".npz")) as partial, partial.open("wb") as stream:
        np.savez(stream, **content)  # pyright: ignore[reportArgumentType]
    write_json(root.with_name(root.name + ".json"), settings)


def write_onnx(file: Path, policy: Policy) -> None:
    """Writes the actor alone: `observation` [N, size] to the unbounded mean `command` [N, 2]."""
    actor = nn.Sequential(policy.scaling, policy.mean_layers).eval()
    example = torch.zeros(1, policy.observation_size)
    with replacing(file) as partial, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the exporter of old opsets says that there is a newer one
        torch.onnx.export(
            actor, (example,), str(partial), dynamo=False, opset_version=OPSET,
            input_names=["observation"], output_names=["command"],
            dynamic_axes={"observation": {0: "N"}, "command": {0: "N"}},
        )  # fmt: skip


def write_path(file: Path, path: CarPath) -> None:
    """Writes a course that `buggy_rl.car.path.load_path` and `paths.kind=file` read."""
    write_atomically(file, "\n".join(path_lines(path)) + "\n")


def move_into_place(source: Path, target: Path) -> list[Path]:
    """Moves the files of a folder into another, each as a whole; returns where they are."""
    placed = []
    for file in sorted(source.iterdir()):
        with replacing(target / file.name) as partial:
            shutil.copyfile(file, partial)
        placed.append(target / file.name)
    return placed


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
        if self.policy.config.actor:
            raise ValueError(
                f"{file} has an actor of its own, {self.policy.config.actor}: the car's runtime "
                "computes the package's network alone; train with policy.actor left out"
            )
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
