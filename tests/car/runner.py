"""Small exported policies of known numbers, and a program that drives one without the package."""

import json

import numpy as np

SETTINGS = {
    "schema": 1,
    "control_period": 0.01,
    "sensing": [],
    "waypoints": {"visible": 2, "lateral_bound": 0.5, "at_once": 3},
    "target_speed": None,
    "observation": {"inputs": ["velocity", "waypoints"], "rows": 1},
    "commands": [],
    "leave_path": 1.0,
    "network": {"activation": "relu", "observation_limit": 5.0},
}
STRAIGHT = [(0.2 * i, 0.0) for i in range(11)]  # 2 m along x

DRIVE = """
import sys
class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("torch", "tensordict", "torchrl", "scipy", "pandas"):
            raise ImportError(name + " is not on the car")
sys.meta_path.insert(0, Blocked())
import json
from buggy_rl.car.path import load_path
from buggy_rl.car.policy import Policy
policy = Policy.load(sys.argv[1])
policy.reset(load_path(sys.argv[2]))
rows = json.load(open(sys.argv[3]))
print(json.dumps([policy.step(pose, tuple(velocity)) for pose, velocity in rows]))
"""


def write_policy(root, layers=None, scaling=(), **settings):
    """Writes ROOT.json and ROOT.npz; the network returns its first two numbers by default."""
    content = {**SETTINGS, **settings}
    row, sizes = content["observation"], {"velocity": 3, "waypoints": 4, "target_speed": 1}
    size = row["rows"] * sum(sizes.get(key, 2) for key in row["inputs"])
    layers = [(np.eye(2, size), np.zeros(2))] if layers is None else layers
    arrays = dict(zip(("mean", "sd"), scaling, strict=False))
    for index, (weight, bias) in enumerate(layers):
        arrays[f"weight_{index}"] = np.float32(weight)
        arrays[f"bias_{index}"] = np.float32(bias)
    np.savez(f"{root}.npz", **arrays)
    root.with_name(root.name + ".json").write_text(json.dumps(content))
    return str(root)
