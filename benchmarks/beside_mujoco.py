"""Other backends beside MuJoCo: how far the same drives part, and milliseconds of a control period.

    python -m benchmarks.beside_mujoco
    python -m benchmarks.beside_mujoco "backends=[closed]" "tyres=[explicit]" cars=4096
    python -m benchmarks.beside_mujoco device=cuda cars=4096

Random drives from 0 to 3 m/s; throttle and steering change four times. MuJoCo steps on the CPU.
"""

import time
from dataclasses import dataclass, field

from buggy_rl.core.config import from_command_line, run


@dataclass(frozen=True)
class Config:
    """What to measure."""

    device: str = "cpu"
    """Where the other backends step: cpu, or cuda."""
    backends: list[str] = field(default_factory=lambda: ["closed", "warp"])
    """Beside MuJoCo; closed has explicit tyres alone."""
    cars: int = 64
    """Environments."""
    seconds: float = 1.0
    """Of a drive."""
    tyres: list[str] = field(default_factory=lambda: ["explicit", "contact"])
    """Tyre models."""


def main() -> None:
    """Drives and prints a table."""
    config = from_command_line(__doc__, f"{__spec__.name if __spec__ else __name__}:Config")

    import torch
    from tqdm import tqdm

    torch.set_num_threads(1)
    rows = []
    for tyres in tqdm(config.tyres, unit="tyre model", leave=False):
        expected, ms = drives(config, tyres, device="cpu", backend="cpu")
        for backend in config.backends:
            if (tyres, backend) == ("contact", "closed"):
                continue
            found, its_ms = drives(config, tyres, device=config.device, backend=backend)
            apart = 1e3 * (found.cpu() - expected).norm(dim=-1)  # [mm]
            figures = (float(apart.median()), float(apart.max()), ms, its_ms)
            told = " | ".join(f"{figure:.3g}" for figure in figures)
            rows.append(f"| {tyres} | {backend} | {told} |")
    print("| tyres | backend | median apart [mm] | farthest [mm] | MuJoCo [ms] | backend [ms] |")
    print("|---|---|--:|--:|--:|--:|", *rows, sep="\n")


def drives(config: Config, tyres: str, device: str, backend: str):
    """Last positions [cars, 2] [m] of the drives, and milliseconds of a control period."""
    import torch
    from tensordict import TensorDict

    from buggy_rl.core import keys
    from buggy_rl.core.vehicle import CONTROL_PERIOD
    from buggy_rl.simulators import make_engine

    engine = make_engine("mujoco", config.cars, device, tyres=tyres, backend=backend)
    generator = torch.Generator().manual_seed(0)
    velocity = torch.zeros(config.cars, 3)
    velocity[:, 0] = 3.0 * torch.rand(config.cars, generator=generator)
    actions = 2.0 * torch.rand(4, config.cars, 2, generator=generator) - 1.0
    actions, steps = actions.to(device), round(config.seconds / CONTROL_PERIOD)
    given = TensorDict({keys.VELOCITY: velocity}, [config.cars], device=device)
    engine.step(engine.rand_action(engine.reset()))  # what compiles does so here
    state, begun = engine.reset(given, set_state=True), time.perf_counter()
    for step in range(steps):
        state[keys.ACTION] = actions[step * len(actions) // steps]
        state = engine.step(state)["next"]
    places = state[keys.POSE][:, :2].cpu()  # waits for the device
    return places, 1e3 * (time.perf_counter() - begun) / steps


if __name__ == "__main__":
    run(main)
