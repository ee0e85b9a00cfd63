"""Less friction around a simulator, beside the same simulator with that friction inside.

    python -m benchmarks.grip "plants=[mujoco,plain]" "grips=[0.4,0.6]" output=grip.json

A plant with its true friction times g is driven for 1.3 s, from gentle to full lock. The unchanged
plant follows it for 0.3 s and is then left alone under the same commands, bare and inside
`tire_grip`. Fitted is the grip at which the effect comes closest, by a robust mean of the
standardised residuals over 1 s, and left what remains of them there.

- `typical`: the buggy's axles and inertia for every simulator that does not say its own, and a
  friction ellipse for all, about what the package did before both were measured.
- `measured`: as shipped.
- `second step`: forces of a second step of the simulator in place of a tyre law.
"""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from buggy_rl.core.config import from_command_line, run

if TYPE_CHECKING:
    from torch import Tensor
    from torchrl.envs import EnvBase

SETTLING, ROWS = 30, 130  # steps that the plant's motion is imposed for, and in all
NOISE = (0.01, 0.01, 0.01, 0.03, 0.03, 0.1)  # m, m, rad, m/s, m/s, rad/s by which residuals count
OUTLIER = 4.0  # [-] standardised residual from which the loss grows linearly
SCAN = (0.8, 1.0, 1.2)  # grips over the true one between which the fitted one is bracketed


@dataclass(frozen=True)
class Config:
    """What to measure."""

    plants: list[str] = field(
        default_factory=lambda: [
            "reference", "mujoco", "contact", "commonroad", "single_track", "heavy", "plain"
        ]
    )  # fmt: skip
    """Simulators; `heavy` and `plain` say nothing of themselves."""
    grips: list[float] = field(default_factory=lambda: [0.4, 0.7])
    """True friction over the simulated."""
    cars: int = 24
    """Drives of each."""
    methods: list[str] = field(default_factory=lambda: ["typical", "measured", "second step"])
    """See above."""
    output: str = ""
    """JSON file for the figures; empty writes none."""


def options_of(make: Callable[[int], "EnvBase"], method: str) -> dict[str, Any]:
    """What `tire_grip` is told of a simulator."""
    from buggy_rl.core.vehicle import VehicleDimensions
    from buggy_rl.effects.measuring import measured_options
    from buggy_rl.effects.measuring.drive import measured_drive
    from buggy_rl.effects.measuring.tyres import measured_tyres

    if method != "typical":
        return measured_options(make)["tire_grip"]
    says = getattr(make(1), "vehicle", VehicleDimensions)
    loss = measured_drive(make)["speed_loss"]
    return measured_tyres(make, says()) | {"speed_loss": loss, "combined_slip": 1.0}


def driven(plant: str, env: "EnvBase", shown: "Tensor | None" = None, rows: int = ROWS) -> "Tensor":
    """Motion [rows + 1, cars, 6]; along `shown` for the first rows, where it is given."""
    import torch
    from benchmarks.gripping.plants import commands

    from buggy_rl.core import keys
    from buggy_rl.core.stepping import reset_at, trajectory

    actions, start = commands(plant, env.batch_size[0], ROWS)

    def act(row: int, state):
        if shown is not None and row <= SETTLING:
            state[keys.POSE], state[keys.VELOCITY] = (x.clone() for x in shown[row].split(3, -1))
        return state.set(keys.ACTION, actions[row])

    states = trajectory(env, reset_at(env, start), act, rows)
    return torch.stack([torch.cat([s[keys.POSE], s[keys.VELOCITY]], -1) for s in states])


def loss(motion: "Tensor", shown: "Tensor") -> float:
    """Robust mean square of standardised residuals, every 0.1 s."""
    residual = (motion - shown)[SETTLING + 10 :: 10] / motion.new_tensor(NOISE)
    return float(2 * OUTLIER**2 * ((1 + (residual / OUTLIER).square()).sqrt() - 1).mean())


def errors(motion: "Tensor", shown: "Tensor") -> list[float]:
    """Mean errors of position [m] and velocity [m/s] after 0.3 s and 1 s."""
    apart = motion - shown
    return [
        float(apart[SETTLING + row][..., part].norm(dim=-1).mean())
        for row in (30, 100)
        for part in (slice(0, 2), slice(3, 5))
    ]


def compared(plant: str, grip: float, method: str, cars: int, known: dict[str, Any]) -> dict:
    """Figures of a method."""
    from benchmarks.gripping.plants import maker
    from benchmarks.gripping.second_step import SecondStep
    from scipy.optimize import minimize_scalar
    from torchrl.envs import TransformedEnv

    from buggy_rl.effects.tyre.grip import TireGrip

    effect = SecondStep if method == "second step" else TireGrip
    shown = driven(plant, maker(plant, grip)(cars))
    bare = driven(plant, maker(plant)(cars), shown)

    def rolled(value: float, rows: int = ROWS) -> "Tensor":
        wrapped = TransformedEnv(maker(plant)(cars), effect(grip=value, **known))
        return driven(plant, wrapped, shown, rows)

    begun = time.perf_counter()
    right = rolled(grip)
    ms = 1e3 * (time.perf_counter() - begun) / ROWS
    found = [loss(rolled(grip * share), shown) for share in SCAN]
    near = min(range(len(SCAN)), key=found.__getitem__)
    ends = (SCAN[max(near - 1, 0)] * grip, SCAN[min(near + 1, len(SCAN) - 1)] * grip)
    best: Any = minimize_scalar(
        lambda value: loss(rolled(value), shown),
        bounds=ends,
        method="bounded",
        options={"xatol": 0.01, "maxiter": 5},
    )
    return {
        "plant": plant, "grip": grip, "method": method,
        "bare": errors(bare, shown), "wrapped": errors(right, shown), "ms": ms,
        "fitted": float(best.x), "left": float(best.fun) / loss(bare, shown),
        "smooth": smoothness(rolled, grip),
        "exact": bool((rolled(1.0) == bare).all()),
    }  # fmt: skip


def smoothness(rolled: Callable[[float, int], "Tensor"], grip: float) -> float:
    """Difference of two secants by the grip, of 0.006 and 0.002, over the first, root mean square.

    Of the first 0.3 s: later, cars that spin part ways.
    """
    last = SETTLING + 30
    wide, narrow = (
        (rolled(grip + h, last) - rolled(grip - h, last))[SETTLING + 10 :: 10] / h
        for h in (0.006, 0.002)
    )
    return float((wide - narrow).norm() / wide.norm())


def table(rows: Sequence[dict]) -> str:
    """As Markdown."""
    head = (
        "| simulator | g | method | 0.3 s: mm, m/s | 1 s: mm, m/s | fitted g | left | "
        "secants | ms a step |\n|---|--:|---|--:|--:|--:|--:|--:|--:|"
    )
    lines = [head]
    for row in rows:
        cells = [row["plant"], f"{row['grip']:g}", row["method"]]
        cells += [
            f"{1e3 * b[0]:.1f} -> {1e3 * a[0]:.1f}, {b[1]:.2f} -> {a[1]:.2f}"
            for b, a in zip(_pairs(row["bare"]), _pairs(row["wrapped"]), strict=True)
        ]
        off = 100 * (row["fitted"] / row["grip"] - 1)
        cells += [f"{row['fitted']:.3f} ({off:+.0f} %)", f"{100 * row['left']:.0f} %"]
        cells += [f"{100 * row['smooth']:.0f} %", f"{row['ms']:.1f}"]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _pairs(numbers: Sequence[float]) -> list[Sequence[float]]:
    return [numbers[:2], numbers[2:]]


def main() -> None:
    """Measures and prints a table."""
    config = from_command_line(__doc__, f"{__spec__.name if __spec__ else __name__}:Config")

    import torch
    from benchmarks.gripping.plants import maker
    from tqdm import tqdm

    torch.set_num_threads(1)
    rows = []
    jobs = [(plant, method) for plant in config.plants for method in config.methods]
    for plant, method in tqdm(jobs):
        known = options_of(maker(plant), method)
        rows += [compared(plant, grip, method, config.cars, known) for grip in config.grips]
        if config.output:
            Path(config.output).write_text(json.dumps(rows, indent=1))
    rows.sort(key=lambda row: (config.plants.index(row["plant"]), row["grip"]))
    print(table(rows))
    wrong = {f"{r['plant']}, {r['method']}" for r in rows if not r["exact"]}
    print(f"not equal to the bare simulator at grip 1: {', '.join(sorted(wrong)) or 'none'}")


if __name__ == "__main__":
    run(main)
