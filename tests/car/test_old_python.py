"""The runner gives the same commands without torch, with an old numpy, and in an old Python.

BUGGY_RL_OLD_NUMPY names a folder with an older numpy for this Python (`pip install --target FOLDER
numpy==1.23.2`), BUGGY_RL_OLD_PYTHON another interpreter with numpy (3.6 with 1.19 is the car's).
"""

import json
import os
import shutil
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from buggy_rl.car.path import load_path
from buggy_rl.car.policy import Policy
from tests.car.runner import DRIVE, write_policy

SOURCE = Path(__file__).parents[2] / "src" / "buggy_rl"
STACK = {
    "sensing": [
        {"name": "past_mean", "width": 5},
        {"name": "clip_velocity", "low": [-1.0, -3.5, -6.5], "high": [3.5, 3.5, 6.5]},
    ],
    "observation": {"inputs": ["velocity", "last_action", "waypoints"], "rows": 3},
    "commands": [{"name": "action_smoothing", "share": 0.2}, {"name": "last_action"}],
    "waypoints": {"visible": 10, "lateral_bound": 0.5, "at_once": 3},
}


@pytest.fixture(scope="module")
def car(tmp_path_factory):
    """What is copied to a car, with a drive of random readings and this Python's commands."""
    folder = tmp_path_factory.mktemp("car")
    shutil.copytree(SOURCE / "car", folder / "buggy_rl" / "car")
    shutil.copy(SOURCE / "__init__.py", folder / "buggy_rl")
    rng = np.random.default_rng(0)
    sizes = [75, 64, 64, 2]
    layers = [(rng.normal(0, 1.4 / n**0.5, (m, n)), rng.normal(0, 0.1, m))
              for n, m in pairwise(sizes)]  # fmt: skip
    scaling = (rng.normal(size=75).astype(np.float32), np.full(75, 0.7, np.float32))
    root = write_policy(folder / "policy", layers, scaling, **STACK)
    (folder / "path.csv").write_text("x,y\n" + "".join(f"{0.2 * i},{0.01 * i * i}\n"
                                                       for i in range(40)))  # fmt: skip
    rows = [([0.02 * i, 0.005 * i, 0.01 * i], rng.normal(0, 2, 3).tolist()) for i in range(300)]
    (folder / "rows.json").write_text(json.dumps(rows))
    policy = Policy.load(root)
    policy.reset(load_path(str(folder / "path.csv")))
    return folder, np.array([policy.step(pose, tuple(velocity)) for pose, velocity in rows])


def driven(folder, python, *path):
    """Commands of another process, that has nothing but the copy."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), *path])}
    command = [python, "-c", DRIVE, "policy", "path.csv", "rows.json"]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return np.array(json.loads(done.stdout))


def test_the_runner_needs_the_copied_folder_and_no_torch(car):
    folder, expected = car
    np.testing.assert_allclose(driven(folder, sys.executable), expected, atol=1e-5)
    assert np.abs(expected).max() > 0.5


def test_with_an_old_numpy_it_gives_the_same(car):
    old = os.environ.get("BUGGY_RL_OLD_NUMPY")
    if not old:
        pytest.skip("BUGGY_RL_OLD_NUMPY names no folder with an older numpy")
    folder, expected = car
    np.testing.assert_allclose(driven(folder, sys.executable, old), expected, atol=1e-5)


def test_in_an_old_python_it_gives_the_same(car):
    old = os.environ.get("BUGGY_RL_OLD_PYTHON")
    if not old:
        pytest.skip("BUGGY_RL_OLD_PYTHON names no interpreter with numpy")
    folder, expected = car
    np.testing.assert_allclose(driven(folder, old), expected, atol=1e-5)


HARDWARE = ("pyrealsense2", "smbus", "smbus2", "pygame", "rclpy")
IMPORT = """
import importlib, sys
for name in sys.argv[1].split(","):
    sys.modules[name] = None
for name in sys.argv[2].split(","):
    importlib.import_module(name)
"""


@pytest.mark.parametrize("python", ["this", "old"])
def test_every_file_is_imported_without_the_libraries_of_the_hardware(car, python):
    chosen = sys.executable if python == "this" else os.environ.get("BUGGY_RL_OLD_PYTHON")
    if not chosen:
        pytest.skip("BUGGY_RL_OLD_PYTHON names no interpreter with numpy")
    folder, _ = car
    names = [f"buggy_rl.car.{file.stem}" for file in (SOURCE / "car").glob("[!_]*.py")]
    command = [chosen, "-c", IMPORT, ",".join(("torch", *HARDWARE)), ",".join(names)]
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
