"""What drivers are compared on: sets of paths, how long each is driven, and the task as judged."""

from dataclasses import dataclass, replace

from buggy_rl.task.env import TaskConfig, TransformConfig, judged
from buggy_rl.task.paths.making import PathConfig

STEPS = 1000  # of an episode in the original study, 10 s
RANDOM_STEPS = 500  # on its third room path


@dataclass(frozen=True)
class Course:
    """A set of paths and how long it is driven."""

    paths: PathConfig
    steps: int


def courses(paths: PathConfig, random_paths: int) -> dict[str, Course]:
    """The original study's path sets: random ones, lap, infinity and the tight random path.

    Args:
        paths: What they are made of.
        random_paths: Of the training paths, the first so many.
    """
    plain = replace(paths, placed=False, mirrored=False, count=random_paths)
    return {
        "training": Course(replace(plain, kind="simplex", part="training"), STEPS),
        "validation": Course(replace(plain, kind="simplex", part="validation"), STEPS),
        "lap": Course(replace(plain, kind="lap"), STEPS),
        "infinity": Course(replace(plain, kind="infinity"), STEPS),
        "random": Course(replace(plain, kind="tight"), RANDOM_STEPS),
    }


def judging(task: TaskConfig, steps: int, camera: bool = False) -> TaskConfig:
    """A task as drivers are judged by it: a path for each car, from its start, so many steps.

    Args:
        task: As in training.
        steps: Of an episode.
        camera: The car is seen through the tracking camera, with its noise; a simulator as it is.
    """
    stack = judged(task.transforms)
    stack["step_limit"] = TransformConfig("step_limit", {"max_steps": steps})
    if camera:
        stack["noise"] = TransformConfig("observation_noise")
    return replace(task, transforms=stack)
