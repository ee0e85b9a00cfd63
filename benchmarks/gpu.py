"""What a GPU buys: environments, PPO and a diagnosis's rollouts, beside this machine's CPU.

    python benchmarks/gpu.py output=gpu.csv
    python benchmarks/gpu.py "engines=[mujoco]" "cars=[1024]" "training=[]" "sets=[]" output=gpu.csv
    python benchmarks/gpu.py "engines=[reference,reference_graph]" output=gpu_graphs.csv
    python benchmarks/gpu.py device=cpu "engines=[kinematic]" "cars=[64]" seconds=0.2 output=cpu.csv

Every figure is measured on `device`, then on the CPU with `threads` threads, in the same run. The
floor is what memory alone would allow: a copy's measured bytes a second over the bytes that a step
must read and write. The CSV has the machine's and the device's name in every row; each row is
written when it is measured, and a run that was stopped goes on behind the rows that are there.
"""

import os
import platform
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from buggy_rl.core.config import from_command_line, run
from buggy_rl.core.files import write_atomically

KEYS = ("what", "engine", "size", "device")  # of a measurement


@dataclass(frozen=True)
class Config:
    """What to measure."""

    device: str = "cuda"
    """cuda, or cpu to try the benchmark itself."""
    engines: list[str] = field(
        default_factory=lambda: ["learned", "kinematic", "single_track", "reference", "mujoco"]
    )
    """Engines, or learned models as .pt; `learned` is an untrained history MLP, `mujoco` MuJoCo
    Warp on a GPU and MuJoCo on the CPU; `kinematic_graph` is `kinematic` with its step recorded as
    a CUDA graph, on a GPU alone."""
    cars: list[int] = field(default_factory=lambda: [64, 1024, 16384, 131072])
    """Environments stepped at once."""
    training: list[int] = field(default_factory=lambda: [256, 4096, 32768])
    """Environments of PPO."""
    sets: list[int] = field(default_factory=lambda: [8, 100, 1000])
    """Parameter sets of a diagnosis, of 60 segments each."""
    threads: int = 2
    """Of the CPU."""
    seconds: float = 1.0
    """Of one measurement."""
    repeats: int = 3
    """Measurements, of which the median is kept."""
    output: str = "gpu.csv"
    """CSV of the figures."""


def main() -> None:
    """Measures and writes."""
    config = from_command_line(__doc__, "gpu:Config")

    import pandas as pd
    import torch
    from tqdm import tqdm

    from scaling.devices import GRAPH, bandwidth, environment, rollouts, training

    refuse_missing(config.device)
    torch.set_num_threads(config.threads)
    kinds = (
        ("environment", environment, config.cars),
        ("ppo", training, config.training),
        ("diagnosis", rollouts, config.sets),
    )
    jobs = [
        (what, measure, engine, size)
        for what, measure, sizes in kinds
        for engine in config.engines
        for size in sizes
    ]
    output = Path(config.output)
    rows = []
    if output.exists():  # with numbers to the last digit: the rows are written again as they were
        rows = pd.read_csv(output, float_precision="round_trip").to_dict("records")
    known = {tuple(str(row[key]) for key in KEYS) for row in rows}
    memory: dict[str, float] = {}
    for what, measure, engine, size in tqdm(jobs, unit="measurement"):
        for device in dict.fromkeys([config.device, "cpu"]):
            if engine.endswith(GRAPH) and device == "cpu":
                continue
            if (what, engine, str(size), device) in known:
                continue
            if device not in memory:
                memory[device] = bandwidth(device, config.seconds)
            found = measure(engine, size, device, config.seconds, config.repeats)
            row = {**about(device), "what": what, "engine": engine, "size": size, **found}
            if "bytes_per_step" in found:
                row["floor_steps_per_s"] = memory[device] / found["bytes_per_step"]
            rows.append({**row, "copy_bytes_per_s": memory[device]})
            write_atomically(output, pd.DataFrame(rows).to_csv(index=False))
    print(f"{pd.DataFrame(rows).to_string(index=False)}\nwritten: {output}")


def refuse_missing(device: str) -> None:
    """Says what to do where there is no such device.

    Raises:
        ValueError: There is none.
    """
    import torch

    if device.startswith("cuda") and not torch.cuda.is_available():
        raise ValueError(
            f"device={device}: torch {torch.__version__} finds no GPU here; run this on a machine "
            "with one and a CUDA build of torch, or try the benchmark itself with device=cpu"
        )


def about(device: str) -> dict[str, Any]:
    """The machine and the device of a row."""
    import torch

    from buggy_rl.core.kernels import FOLDER

    name = torch.cuda.get_device_name() if device.startswith("cuda") else platform.processor()
    load = round(os.getloadavg()[0], 1)
    kernels = "none" if os.environ.get(FOLDER) == "" else "where compiled"
    own = {"machine": platform.node(), "cores": os.cpu_count(), "load": load, "kernels": kernels}
    return {**own, "device": device, "device_name": name, "torch": torch.__version__}


if __name__ == "__main__":
    run(main)
