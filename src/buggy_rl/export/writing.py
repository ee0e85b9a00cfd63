"""The files of an exported policy."""

import hashlib
import json
import shutil
import warnings
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from buggy_rl.car.path import Path as CarPath
from buggy_rl.car.path import path_lines
from buggy_rl.car.policy_file import SCHEMA
from buggy_rl.core.files import replacing, write_atomically, write_json
from buggy_rl.policies.training.actor_critic import OBSERVATION_LIMIT, Policy, Scaling

OPSET = 11  # of ONNX: what the ONNX runtimes of 2019 and later load
ACTION_MAP = {
    "throttle": {"low": -1.0, "high": 1.0, "meaning": "-1 is no drive, 1 is full drive"},
    "steering": {"low": -1.0, "high": 1.0, "meaning": "1 is full left"},
}
TWO_WAY_THROTTLE = "0 is no drive, 1 is full drive, -1 is full brake or reverse"


def arrays(policy: Policy) -> dict[str, NDArray]:
    """The actor's numbers, float32: weight_i [out, in], bias_i [out], mean and sd [in]."""
    layers = [layer for layer in policy.mean_layers if isinstance(layer, nn.Linear)]
    content = {}
    for index, layer in enumerate(layers):
        content[f"weight_{index}"] = layer.weight.numpy()
        content[f"bias_{index}"] = layer.bias.numpy()
    if isinstance(policy.scaling, Scaling):
        content["mean"] = policy.scaling.mean.numpy()
        content["sd"] = policy.scaling.sd.numpy()
    return content


def settings(
    policy: Policy, about: dict[str, Any], file: Path, task: dict[str, Any], two_way: bool = False
) -> dict:
    """The JSON beside the numbers."""
    config, action = policy.config, ACTION_MAP
    if two_way:
        action = {**action, "throttle": {**action["throttle"], "meaning": TWO_WAY_THROTTLE}}
    return {
        "schema": SCHEMA,
        "buggy_rl": version("buggy_rl"),
        "training": _training(about, file),
        **task,
        "network": {
            "hidden": list(config.hidden),
            "activation": config.activation,
            "observation_limit": OBSERVATION_LIMIT,
        },
        "action": action,
        **({"two_way": True} if two_way else {}),
    }


def _training(about: dict[str, Any], file: Path) -> dict[str, Any]:
    config = about["config"]
    canonical = json.dumps(config, sort_keys=True).encode()
    note = file.parent / "run.json"
    run = json.loads(note.read_text()) if note.is_file() else {}
    return {
        "policy": file.name,
        "policy_sha256": hashlib.sha256(file.read_bytes()).hexdigest(),
        "config_sha256": hashlib.sha256(canonical).hexdigest(),
        "commit": run.get("commit", f"unknown: there is no run.json beside {file.name}"),
        "simulator": config["engine"]["simulator"],
        "seed": config["seed"],
        "steps": about.get("steps"),
    }


def write_pair(root: Path, settings: dict[str, Any], content: dict[str, NDArray]) -> None:
    """Writes ROOT.npz and ROOT.json."""
    with replacing(root.with_name(root.name + ".npz")) as partial, partial.open("wb") as stream:
        np.savez(stream, **content)  # pyright: ignore[reportArgumentType]
    write_json(root.with_name(root.name + ".json"), settings)


def write_onnx(file: Path, policy: Policy) -> None:
    """Writes the actor alone: `observation` [N, size] to the unbounded mean `command` [N, 2]."""
    actor = nn.Sequential(policy.scaling, policy.mean_layers).eval()
    example = torch.zeros(1, policy.observation_size)
    with replacing(file) as partial, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the exporter of old opsets says that there is a newer one
        torch.onnx.export(
            actor, (example,), str(partial), dynamo=False, opset_version=OPSET,
            input_names=["observation"], output_names=["command"],
            dynamic_axes={"observation": {0: "N"}, "command": {0: "N"}},
        )  # fmt: skip


def write_path(file: Path, path: CarPath) -> None:
    """Writes a course that `buggy_rl.car.path.load_path` and `paths.kind=file` read."""
    write_atomically(file, "\n".join(path_lines(path)) + "\n")


def move_into_place(source: Path, target: Path) -> list[Path]:
    """Moves the files of a folder into another, each as a whole; returns where they are."""
    placed = []
    for file in sorted(source.iterdir()):
        with replacing(target / file.name) as partial:
            shutil.copyfile(file, partial)
        placed.append(target / file.name)
    return placed
