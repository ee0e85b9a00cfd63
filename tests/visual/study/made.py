"""A study's folder with made-up results, as its stages would have written them."""

import json

import numpy as np
import torch
import yaml
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.estimation.open_loop import save_rollouts

NAMES = ("MLP", "mujoco, fitted", "mujoco, as shipped")
HEAD = (
    "simulator,position_mse_1s,low,high,position_median_1s,position_0.3s,position_1s,position_3s,"
    "yaw_0.3s,yaw_1s,yaw_3s,yaw_rate_0.3s,yaw_rate_1s,yaw_rate_3s"
)
ANSWER = {
    "verdict": "missing_physics",
    "summary": ["Physics is missing from the simulator.", "The steering is late <60 ms>."],
    "effects": [
        {
            "name": "steering_dead_time",
            "kind": "actuation",
            "equation": "u'(t) = u(t - dead_time)",
            "confidence": 0.97,
            "parameters": {"dead_time": {"value": 0.06, "low": 0.055, "high": 0.065, "unit": "s"}},
        }
    ],
    "layers": [
        {
            "kind": "effects",
            "names": ["steering_dead_time"],
            "gain": 0.9,
            "standard_error": 0.1,
            "kept": True,
            "position_median": {"0.3 s": 0.004, "1 s": 0.012},
        },
        {
            "kind": "parameters",
            "names": [f"parameter:p{k}" for k in range(9)],
            "gain": -0.1,
            "standard_error": 0.1,
            "kept": False,
            "position_median": {"0.3 s": 0.005, "1 s": 0.013},
        },
    ],
    "fit": {
        "position_median": {
            "before": {"0.3 s": 0.02, "1 s": 0.08},
            "retuned": {"0.3 s": 0.015, "1 s": 0.05},
        }
    },
}


def straight(segments=6, rows=301, speed=1.0):
    """[N, rows] along x at a speed, 10 ms a row."""
    x = speed * 0.01 * torch.arange(rows).float().expand(segments, rows)
    pose = torch.stack([x, torch.zeros_like(x), torch.zeros_like(x)], -1)
    return TensorDict({keys.POSE: pose}, [segments, rows])


def table(folder, errors):
    """table.csv with the 1 s position MSE of each simulator."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = [HEAD] + [
        f'"{n}",{e},{0.5 * e},{2 * e},{0.8 * np.sqrt(e)},0.01,{np.sqrt(e)},0.9,1,1,1,2,2,2'
        for n, e in errors.items()
    ]
    (folder / "table.csv").write_text("\n".join(lines) + "\n")


def write(folder):
    """Everything that the page reads."""
    table(folder, dict(zip(NAMES, (0.004, 0.002, 0.05), strict=True)))
    made = {name: straight(speed=speed) for name, speed in zip(NAMES, (1.1, 0.9, 1.5), strict=True)}
    save_rollouts(folder / "rollouts.npz", ["drive_07"] * 6, 0.01, straight(), made)
    about = {"low": 0.6, "high": 0.8, "unit": "-", "started_from": 0.9, "warnings": ["weak <b>"]}
    content = {"engine": "mujoco", "parameters": {"friction": 0.7}, "_fit": {"friction": about}}
    (folder / "mujoco_fitted.yaml").write_text(yaml.safe_dump(content))
    (folder / "diagnosis").mkdir()
    (folder / "diagnosis" / "diagnosis.json").write_text(json.dumps(ANSWER))
    table(folder / "repair", {"fitted": 0.002, "repaired": 0.0005, "hold last": 0.4})
    (folder / "policies").mkdir()
    rows = ["policy,place,course,waypoints"]
    for policy in ("learned", "fitted"):
        for place, lost in (("learned", 0), ("fitted", 6), ("car", 12)):
            own = 0 if policy == place else lost + (6 if place == "learned" else 0)
            rows += [f"{policy},{place},{c},{60 - own}" for c in ("lap", "infinity", "random")]
    (folder / "policies" / "policies.csv").write_text("\n".join(rows) + "\n")
    (folder / "figures").mkdir()
    (folder / "figures" / "signals.png").write_bytes(b"\x89PNG made up")
    (folder / "figures" / "driven.png").write_bytes(b"0" * 500_000)
