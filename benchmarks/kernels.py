"""Milliseconds of a call of each kernel, by its compiled package and by PyTorch.

    python scripts/compile.py
    python benchmarks/kernels.py "cars=[64,640,6000]"

Both alternate in one process of one thread, and the figures are medians. Run it on a quiet machine.
"""

import json
import statistics
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from buggy_rl.core.config import from_command_line, run


@dataclass(frozen=True)
class Config:
    """What to measure."""

    cars: list[int] = field(default_factory=lambda: [64, 640, 6000])
    """Batch sizes."""
    repeats: int = 50
    """Calls of each kind."""
    output: str = ""
    """JSON file for the figures; empty writes none."""


def main() -> None:
    """Measures and prints a table."""
    config = from_command_line(__doc__, f"{__spec__.name if __spec__ else __name__}:Config")

    import torch
    from tqdm import tqdm

    from buggy_rl.core.kernels import kernels

    torch.set_num_threads(1)
    rows: list[dict[str, Any]] = []
    with torch.no_grad():
        for kernel, cars in tqdm([(k, n) for k in kernels() for n in config.cars]):
            run = kernel.compiled(torch.ones(2))
            if run is None:
                raise ValueError(
                    f"no package of {kernel.name} of this source: python scripts/compile.py"
                )
            arguments, ms = kernel.example(cars), {"pytorch": [], "package": []}
            for _ in range(config.repeats):
                for name, call in (("pytorch", kernel.function), ("package", run)):
                    start = time.perf_counter()
                    call(*arguments)
                    ms[name].append(1e3 * (time.perf_counter() - start))
            medians = {name: statistics.median(times) for name, times in ms.items()}
            rows.append({"kernel": kernel.name, "cars": cars, **medians})
    print("| kernel | cars | PyTorch, ms | package, ms | ratio |\n|---|--:|--:|--:|--:|")
    for row in rows:
        cells = (row["pytorch"], row["package"], row["pytorch"] / row["package"])
        figures = " | ".join(f"{cell:.3g}" for cell in cells)
        print(f"| {row['kernel']} | {row['cars']} | {figures} |")
    if config.output:
        Path(config.output).write_text(json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    run(main)
