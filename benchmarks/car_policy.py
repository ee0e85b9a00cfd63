"""Microseconds of a step of the car's numpy policy: filters, waypoints, network, command.

    python benchmarks/car_policy.py
    python benchmarks/car_policy.py policy=runs/mujoco/car/policy path=runs/mujoco/car/lap.csv

Without a policy one of the default size is measured: two layers of 64, ten waypoints, past mean of
five, last action. Its peer is PyTorch on the network alone, in the same process of one thread, step
by step in turn. The parts of a step are measured by themselves.
"""

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from buggy_rl.core.config import from_command_line, run

TARGET = 50.0  # [us] median of a whole step


@dataclass(frozen=True)
class Config:
    """What to measure."""

    policy: str = ""
    """An exported policy; empty for one of the default size with random weights."""
    path: str = ""
    """Its path; empty for a circle of 1 m radius."""
    steps: int = 20000
    """Steps measured."""
    warm_up: int = 1000
    """Steps before."""
    seed: int = 0
    """Of the weights and the velocities."""
    output: str = ""
    """JSON file for the figures; empty writes none."""


def main() -> None:
    """Measures and prints a table."""
    config = from_command_line(__doc__, f"{__spec__.name if __spec__ else __name__}:Config")

    import numpy as np
    import torch
    from tqdm import tqdm

    torch.set_num_threads(1)
    policy, path = _policy(config), _path(config)
    policy.reset(path)
    rng = np.random.default_rng(config.seed)
    angles = 0.01 * np.arange(config.warm_up + config.steps)  # 1 m/s about 1 m
    poses = np.stack([np.cos(angles), np.sin(angles), angles + np.pi / 2], -1).tolist()
    velocities = rng.normal([1.0, 0.0, 1.0], 0.2, (len(poses), 3)).tolist()
    parts = _parts(policy)
    times: dict[str, list[float]] = {name: [] for name in ("whole step", *parts)}
    for pose, velocity in zip(tqdm(poses), velocities, strict=True):
        times["whole step"].append(_time(lambda: policy.step(pose, velocity)))  # noqa: B023
        for name, call in parts.items():
            times[name].append(_time(call))
    rows = {}
    print("| part | median, us | p99, us |\n|---|--:|--:|")
    for name, taken in times.items():
        kept = taken[config.warm_up :]
        rows[name] = {"median": float(np.median(kept)), "p99": float(np.percentile(kept, 99))}
        print(f"| {name} | {rows[name]['median']:.1f} | {rows[name]['p99']:.1f} |")
    met = "met" if rows["whole step"]["median"] < TARGET else "NOT met"
    print(f"target: a median below {TARGET:g} us for the whole step: {met}; numpy {np.__version__}")
    if config.output:
        Path(config.output).write_text(json.dumps(rows, indent=2) + "\n")


def _time(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return 1e6 * (time.perf_counter() - start)


def _parts(policy) -> dict[str, Callable[[], object]]:
    """Parts of the step that was just taken, and the peer."""
    import numpy as np
    import torch

    x, y, yaw = np.float32(0.3), np.float32(0.4), np.float32(0.5)
    shown = policy.observation.waypoints
    torch_network = _torch_network(policy)
    row = torch.from_numpy(policy.observation.values.copy())[None]

    def peer() -> object:
        with torch.inference_mode():
            return torch_network(row)

    return {
        "network": lambda: policy._network(policy.observation.values),
        "waypoints seen": lambda: policy.waypoints.see(x, y, yaw, shown),
        "distance to the path": lambda: policy.waypoints.errors(x, y, yaw),
        "PyTorch, network alone": peer,
    }


def _torch_network(policy):
    """The same layers in PyTorch, without the scaling."""
    import torch
    from torch import nn

    modules: list[nn.Module] = []
    for weight, bias, _ in policy._network._layers:
        layer = nn.Linear(weight.shape[1], weight.shape[0])
        layer.weight = nn.Parameter(torch.from_numpy(weight))
        layer.bias = nn.Parameter(torch.from_numpy(bias))
        modules += [layer, nn.ReLU()]
    return nn.Sequential(*modules[:-1])


def _policy(config: Config):
    """The exported policy, or one of the default size."""
    import numpy as np

    from buggy_rl.car.policy import Policy
    from buggy_rl.car.policy_file import PolicyFile

    if config.policy:
        return Policy.load(config.policy)
    settings = {
        "schema": 1,
        "control_period": 0.01,
        "sensing": [
            {"name": "past_mean", "width": 5},
            {"name": "clip_velocity", "low": [-1.0, -3.5, -6.5], "high": [3.5, 3.5, 6.5]},
        ],
        "waypoints": {"visible": 10, "lateral_bound": 0.5, "at_once": 3},
        "target_speed": None,
        "observation": {"inputs": ["velocity", "last_action", "waypoints"], "rows": 1},
        "commands": [{"name": "last_action"}],
        "leave_path": 1.0,
        "network": {"activation": "relu", "observation_limit": 5.0},
    }
    rng, sizes = np.random.default_rng(config.seed), (25, 64, 64, 2)
    arrays = {"mean": np.zeros(25, np.float32), "sd": np.ones(25, np.float32)}
    for index in range(3):
        rows, columns = sizes[index + 1], sizes[index]
        arrays[f"weight_{index}"] = rng.normal(0, columns**-0.5, (rows, columns)).astype("f4")
        arrays[f"bias_{index}"] = np.zeros(rows, np.float32)
    return Policy(PolicyFile(settings, arrays))


def _path(config: Config):
    """The path of the file, or a circle with waypoints 0.2 m apart."""
    import numpy as np

    from buggy_rl.car.path import Path, load_path

    if config.path:
        return load_path(config.path)
    angles = np.arange(31) * 2 * np.pi / 31
    return Path(np.stack([np.cos(angles), np.sin(angles)], -1), True)


if __name__ == "__main__":
    run(main)
