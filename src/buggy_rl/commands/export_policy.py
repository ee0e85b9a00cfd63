r"""Writes a trained policy for the car's computer: numpy and JSON, ONNX, and courses to follow.

    python scripts/export_policy.py policy=runs/mujoco/best.pt output=runs/mujoco/car/policy
    python scripts/export_policy.py policy=runs/mujoco/best.pt output=runs/mujoco/car/policy \
        course=lap,random,my_course.csv

Before that it is compared with the simulator that it was trained in: observation and command of
every step of whole drives, and on random poses and velocities. Above `tolerance` nothing is
written.
"""

import os

from buggy_rl.core.config import from_command_line, run


def main() -> None:
    """Compares, writes, and says how far apart runtime and training were."""
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    config = from_command_line(__doc__, "buggy_rl.export.export:ExportConfig")

    import torch

    from buggy_rl.export.export import export
    from buggy_rl.jobs.bar import tqdm

    torch.set_num_threads(config.threads)
    files = []
    with tqdm(export(config), "comparing", unit="drive") as bar:
        for where, result in bar:
            if where == "files":
                files = result
            else:
                numbers = ", ".join(f"{k} {_figure(v)}" for k, v in result.items())
                bar.write(f"{where}: {numbers}")
    print("largest differences above, between the car's runtime and training; written:")
    print("\n".join(f"  {file}" for file in files))


def _figure(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.2g}" if value < 1 else f"{value:g}"


if __name__ == "__main__":
    run(main)
