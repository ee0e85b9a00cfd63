"""Effects realised by a simulator's own parameters, beside the same effects wrapped around it.

    python -m benchmarks.inside
    python -m benchmarks.inside "plants=[reference]" "effects=[tire_grip]" output=inside.json

A plant in which an effect is concealed is driven for 1.3 s, from gentle to full lock. The unchanged
plant follows it for 0.3 s and is then left alone under the same commands: bare, with the effect
around it, and with the parameters that it declares for it, each at the true number. Left is what
remains of a robust mean of the standardised residuals over 1 s (`benchmarks.grip`).
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from buggy_rl.core.config import from_command_line, run

if TYPE_CHECKING:
    from torch import Tensor

NUMBERS = {  # effect -> its number, and where it is tried
    "tire_grip": ("grip", (0.4, 0.6, 0.8)),
    "grip_balance": ("front_to_rear", (0.7, 1.4)),
    "payload": ("mass_ratio", (1.3,)),
    "top_speed": ("speed_ratio", (0.7,)),
    "steering_gain": ("gain", (0.8, 1.2)),
    "steering_asymmetry": ("left_to_right", (1.3,)),
    "steering_dead_time": ("dead_time", (0.05,)),
    "throttle_dead_time": ("dead_time", (0.05,)),
}


@dataclass(frozen=True)
class Config:
    """What to measure."""

    plants: list[str] = field(default_factory=lambda: ["reference", "mujoco"])
    """Engines that declare what they realise, and conceal effects as plants."""
    effects: list[str] = field(default_factory=lambda: list(NUMBERS))
    """Of those that a plant realises."""
    cars: int = 24
    """Drives of each."""
    output: str = ""
    """JSON file for the figures; empty writes none."""


def rollouts(
    plant: str, effect: str, value: float, cars: int, known: dict[str, Any]
) -> tuple["Tensor", dict[str, "Tensor"]]:
    """Motion of the plant with the effect, and of the unchanged one bare, wrapped and inside."""
    import torch
    from benchmarks.grip import driven

    from buggy_rl.effects import effect_class
    from buggy_rl.estimation.inside import Inside
    from buggy_rl.proof.plants import make_plant
    from buggy_rl.task.augment import augmented

    number, engine = NUMBERS[effect][0], make_plant(plant, cars, {})
    shown = driven(plant, make_plant(plant, cars, {effect: {number: value}}))
    inside = Inside(engine.realises, engine.declared, [effect])  # type: ignore[attr-defined]
    values = {p.name: torch.full((cars,), p.value) for p in effect_class(effect).declared}
    values[number] = torch.full((cars,), value)
    _, own = inside.moved({effect: values}, {})
    made = {
        "bare": engine,
        "wrapped": augmented(engine, {effect: values}, {}, (), known)[0],
        "inside": augmented(engine, {}, own)[0],
    }
    return shown, {name: driven(plant, env, shown) for name, env in made.items()}


def compared(
    plant: str, effect: str, value: float, cars: int, known: dict[str, Any]
) -> dict[str, Any]:
    """Figures of an effect at a value."""
    from benchmarks.grip import errors, loss

    shown, motions = rollouts(plant, effect, value, cars, known)
    bare = loss(motions["bare"], shown)
    return {
        "plant": plant, "effect": effect, "value": value,
        **{name: errors(motion, shown) for name, motion in motions.items()},
        "left": {name: loss(motion, shown) / bare for name, motion in motions.items()},
    }  # fmt: skip


def table(rows: Sequence[dict[str, Any]]) -> str:
    """As Markdown: errors of position after 0.3 s and 1 s, and what is left."""
    lines = [
        "| simulator | effect | bare [mm] | wrapped [mm] | inside [mm] | left: wrapped | inside |",
        "|---|---|--:|--:|--:|--:|--:|",
    ]
    for row in rows:
        cells = [row["plant"], f"`{row['effect']}` {row['value']:g}"]
        for name in ("bare", "wrapped", "inside"):
            cells.append(f"{1e3 * row[name][0]:.1f}, {1e3 * row[name][2]:.0f}")
        cells += [f"{100 * row['left'][name]:.1f} %" for name in ("wrapped", "inside")]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    """Measures and prints a table."""
    config = from_command_line(__doc__, f"{__spec__.name if __spec__ else __name__}:Config")

    import torch
    from benchmarks.gripping.plants import maker
    from tqdm import tqdm

    from buggy_rl.effects.measuring import measurable_options

    torch.set_num_threads(1)
    rows = []
    for plant in config.plants:
        known, _ = measurable_options(maker(plant))
        realised = maker(plant)(1).realises  # type: ignore[attr-defined]
        for effect in tqdm([e for e in config.effects if e in realised], plant):
            for value in NUMBERS[effect][1]:
                rows.append(compared(plant, effect, value, config.cars, known))
    print(table(rows))
    if config.output:
        Path(config.output).write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    run(main)
