"""Who may import whom, read off the source: the plan of the house, kept true."""

import ast
import sys
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src" / "buggy_rl"

GROUND = {
    *("keys", "parameters", "vehicle", "similarity", "car_file", "config", "files", "jobs"),
    *("stepping", "kernels", "longitudinal", "realisation", "option_values"),
    *("trust", "reads", "question", "signed", "extras"),
}
SIMULATION = GROUND | {"recordings", "models", "engines", "effects", "task"}
ALLOWED = {  # a part of the package and what it may import of ours, beside itself
    "keys": set(),
    "parameters": {"keys"},
    "vehicle": {"keys", "parameters"},
    "similarity": {"parameters", "vehicle"},
    "longitudinal": set(),
    "realisation": set(),
    "car_file": {"config", "longitudinal", "similarity", "vehicle"},
    "config": {"option_values", "trust", "files"},
    "option_values": set(),
    "trust": set(),
    "extras": set(),
    "reads": set(),
    "question": {"reads", "__version__"},
    "signed": {"files"},
    "files": set(),
    "jobs": {"files", "question", "reads", "extras"},
    "stepping": set(),
    "kernels": {"config"},
    "run_log": {"files", "extras"},
    "recordings": GROUND,
    "models": GROUND | {"recordings"},
    "engines": GROUND | {"recordings", "models"},
    "plants": GROUND | {"recordings", "engines"},
    "effects": GROUND,
    "task.paths": GROUND,
    "task.transforms": GROUND | {"task.paths"},
    "task": SIMULATION,
    "inspection": SIMULATION | {"viz"},
    "policies": SIMULATION | {"car"},
    "estimation": SIMULATION,
    "identification": SIMULATION | {"estimation"},
    "diagnosis.report": SIMULATION | {"estimation", "diagnosis", "viz"},
    "diagnosis": SIMULATION | {"estimation"},
    "blind_test": SIMULATION
    | {"plants", "policies", "estimation", "identification", "diagnosis", "viz"},
    "transfer": SIMULATION | {"plants", "policies", "blind_test", "viz"},
    "study": SIMULATION | {"estimation", "identification", "policies", "viz"},
    "viz": SIMULATION | {"policies", "car"},
    "car": set(),
    "simulated_car": SIMULATION | {"car"},
}
# For whoever types a command: above all else. Names for whoever writes Python need no proof.
ALLOWED["commands"] = {*ALLOWED, "api", "__version__"}
ALLOWED["api"] = SIMULATION | {"estimation", "identification", "diagnosis", "policies", "run_log"}
ALLOWED["__main__"] = {"commands", "config"}
# Beside these, no engine knows of another.
SHARED_BY_ENGINES = ("engines.base", "engines.bicycle.longitudinal", "engines.bicycle.parameters")
ONLY_IN = {  # a library and the modules that may import it
    "matplotlib": ("viz", "study.figures", "blind_test.pictures", "transfer.pictures"),
    "mujoco": ("engines.mujoco", "viz", "blind_test.baselines.sysid"),
    "dm_control": ("engines.mujoco", "viz"),
    "mujoco_warp": ("engines.mujoco.warp_cars",),
    "warp": ("engines.mujoco.warp_cars",),
    "ray": ("jobs.on_ray", "policies.collecting"),
    "submitit": ("jobs.on_submitit",),
    "optuna": ("policies.sweep",),
    "pyrealsense2": ("car.camera_t265",),  # libraries of the car's hardware, imported when used
    "smbus": ("car.pwm_pca9685",),
    "smbus2": ("car.pwm_pca9685",),
    "pygame": ("car.joystick",),
    "rclpy": ("car.ros",),
}


def imports(source):
    """Full names of all that a source imports, inside functions too."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"relative import of {node.module}: write the full name"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def within(module, places):
    return any(module == place or module.startswith(place + ".") for place in places)


def part_of(module):
    """The longest entry of the table that a module belongs to; empty if there is none."""
    return max((part for part in ALLOWED if within(module, [part])), key=len, default="")


def faults(module, source):
    """What a module of the package, such as `engines.learned`, imports against the rules."""
    if not part_of(module):
        return [f"{module}: it is not in the table of who may import whom"]
    return [f"{module} imports {name}" for name in imports(source) if not allowed(module, name)]


def allowed(module, name):
    top, _, inner = name.partition(".")
    part = part_of(module)
    if top == "scripts":
        return False
    if top in ONLY_IN:
        return within(module, ONLY_IN[top])
    if top != "buggy_rl":
        return part != "car" or top == "numpy" or top in sys.stdlib_module_names
    if part == "engines" and within(inner, ["engines"]):
        own, theirs = (f"{place}..".split(".")[1] for place in (module, inner))
        return own == theirs or own == "" or within(inner, SHARED_BY_ENGINES)
    return within(inner, {part, *ALLOWED[part]})


def modules():
    for file in sorted(SOURCE.rglob("*.py")):
        names = file.relative_to(SOURCE).with_suffix("").parts
        names = names[:-1] if names[-1] == "__init__" else names
        if names:
            yield ".".join(names), file.read_text()


def test_every_module_imports_only_what_it_may_know():
    assert [fault for module, source in modules() for fault in faults(module, source)] == []


def test_no_module_is_called_utils():
    assert [module for module, _ in modules() if "utils" in module.split(".")] == []


@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("engines.learned", "from buggy_rl.task.transforms.waypoints import Waypoints"),
        ("engines.learned", "from buggy_rl.task import env"),
        ("engines.learned", "from buggy_rl.engines.bicycle.single_track import SingleTrackEngine"),
        ("engines.reference.tyres", "from buggy_rl.engines.mujoco import tyres"),
        ("task.transforms.observation", "import buggy_rl.effects.motion"),
        ("vehicle", "from buggy_rl.recordings.windows import windows"),
        ("keys", "from buggy_rl import parameters"),
        ("models.mlp", "from buggy_rl.engines import make_engine"),
        ("identification.table", "def f():\n    import matplotlib.pyplot as plt"),
        ("engines.reference", "from dm_control import mjcf"),
        ("car.runtime", "import torch"),
        ("car.runtime", "from buggy_rl.vehicle import rotate"),
        ("car.runtime", "import smbus2"),
        ("policies.ppo", "import scripts.train_policy"),
        ("toolbox", "import math"),
    ],
)
def test_a_planted_violation_is_caught(module, line):
    assert len(faults(module, line)) == 1


@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("engines.learned", "from buggy_rl.engines.base import Engine"),
        ("engines.mujoco.engine", "from buggy_rl.engines.mujoco.car import Car\nimport mujoco"),
        ("diagnosis.report", "from buggy_rl.viz.svg import svg"),
        ("car.runtime", "import numpy as np, json\nfrom buggy_rl.car.watchdog import Watchdog"),
    ],
)
def test_an_honest_import_is_not(module, line):
    assert faults(module, line) == []


def packages_imported():
    """Part of the table -> the parts that its modules import."""
    graph = {}
    for module, source in modules():
        ours = [name.removeprefix("buggy_rl.") for name in imports(source)]
        others = {part_of(name) for name in ours} - {part_of(module), ""}
        graph.setdefault(part_of(module), set()).update(others)
    return graph


def test_no_part_imports_itself_by_way_of_others():
    graph = packages_imported()

    def reached(part, seen):
        for other in graph.get(part, ()):
            if other not in seen:
                reached(other, seen | {other})
                seen.add(other)
        return seen

    # `task` makes an environment of engines, effects and its own transforms, which know no `task`.
    assert [part for part in graph if part in reached(part, set())] == []
