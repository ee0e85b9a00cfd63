"""Partial resets: CPU milliseconds of a step of the task, and of a reset of one car of the batch.

    python -m benchmarks.resets
    python -m benchmarks.resets "cars=[256]" "simulators=[learned]"

A step is followed by a reset of one car, as a collector does it where an episode ends. The three
are timed in turn on one thread, and the least times are compared, since others only add to them.
`all` resets the whole batch.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from buggy_rl.core.config import from_command_line, run


@dataclass(frozen=True)
class Config:
    """What to measure."""

    simulators: list[str] = field(default_factory=lambda: ["single_track", "mujoco", "learned"])
    """Engines; `learned` is an untrained history MLP of 20 rows."""
    cars: list[int] = field(default_factory=lambda: [256, 1024])
    """Environments."""
    repeats: int = 200
    """Steps that are timed."""


def main() -> None:
    """Measures and prints a table."""
    config = from_command_line(__doc__, f"{__spec__.name if __spec__ else __name__}:Config")

    import torch
    from tqdm import tqdm

    torch.set_num_threads(1)
    cases = [(name, cars) for name in config.simulators for cars in config.cars]
    rows = []
    for name, cars in tqdm(cases, unit="case", leave=False):
        with torch.no_grad():
            step, one, every = timed(name, cars, config.repeats)
        share = f"{100 * one / step:.0f} %"
        rows.append(f"| {name} | {cars} | {step:.2f} | {one:.2f} | {share} | {every:.2f} |")
    print("| simulator | cars | step [ms] | reset of one [ms] | of a step | all [ms] |")
    print("|---|--:|--:|--:|--:|--:|", *rows, sep="\n")


def timed(name: str, cars: int, repeats: int) -> tuple[float, float, float]:
    """Least milliseconds of a step, of a reset of one car, and of one of all cars."""
    import torch
    from torchrl.envs.utils import step_mdp

    from buggy_rl.core import keys
    from buggy_rl.simulators import make_engine
    from buggy_rl.simulators.learned.factory import ModelConfig, make_model
    from buggy_rl.task.env import make_env

    options: dict[str, Any] = {}
    if name == "learned":
        options["model"] = make_model(ModelConfig("mlp", options={"rows": 20}))
    env = make_env(make_engine(name, cars, **options))
    state = step_mdp(env.rand_step(env.reset())).set(keys.ACTION, torch.zeros(cars, 2))
    mask = torch.zeros(cars, 1, dtype=torch.bool)
    mask[cars // 2] = True
    works: list[Callable[[Any], Any]] = [
        env.step,
        lambda td: env.reset(td.set("_reset", mask.clone()), select_reset_only=True),
        lambda _: env.reset(),
    ]
    taken: list[list[float]] = [[] for _ in works]
    for _ in range(repeats):
        for work, own in zip(works, taken, strict=True):
            given = state.clone()
            begun = time.process_time()
            work(given)
            own.append(time.process_time() - begun)
    step, one, every = (1e3 * min(own) for own in taken)
    return step, one, every


if __name__ == "__main__":
    run(main)
