"""The benchmark: sets of paths, the steps of an episode on each, and the task in evaluation."""

from dataclasses import dataclass, replace

from buggy_rl.task.config import TaskConfig, TransformConfig, evaluation_transforms
from buggy_rl.task.paths.making import PathConfig

STEPS = 1000  # of an episode in the original study, 10 s
RANDOM_STEPS = 500  # on its third room path


@dataclass(frozen=True)
class Benchmark:
    """A set of paths and the steps of an episode on them."""

    paths: PathConfig
    steps: int


def benchmark_paths(paths: PathConfig, random_paths: int) -> dict[str, Benchmark]:
    """The original study's path sets: random ones, lap, infinity and the tight random path.

    Of the training paths they have the first `random_paths`.
    """
    plain = replace(paths, placed=False, mirrored=False, count=random_paths)
    return {
        "training": Benchmark(replace(plain, kind="simplex", part="training"), STEPS),
        "validation": Benchmark(replace(plain, kind="simplex", part="validation"), STEPS),
        "lap": Benchmark(replace(plain, kind="lap"), STEPS),
        "infinity": Benchmark(replace(plain, kind="infinity"), STEPS),
        "random": Benchmark(replace(plain, kind="tight"), RANDOM_STEPS),
    }


def evaluation_task(task: TaskConfig, steps: int, camera: bool = False) -> TaskConfig:
    """A task as policies are evaluated on it: one path each, from its start, for `steps` steps.

    `camera` adds the tracking camera's noise, as on the car.
    """
    stack = evaluation_transforms(task.transforms)
    stack["step_limit"] = TransformConfig("step_limit", {"max_steps": steps})
    if camera:
        stack["noise"] = TransformConfig("observation_noise")
    return replace(task, transforms=stack)
