"""Who may import whom, read off the source: the plan of the house, kept true."""

import ast
import sys
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src" / "buggy_rl"

GROUND = {
    *("core.keys", "core.parameters", "core.vehicle", "core.car_file", "core.config"),
    *("core.files", "core.stepping", "core.kernels", "core.longitudinal", "core.option_values"),
    *("core.trust", "core.reads", "core.question", "core.extras", "jobs"),
}
SIMULATION = GROUND | {"recordings", "simulators", "effects", "task"}
ABOVE = SIMULATION | {
    *("core.run_log", "estimation", "diagnosis", "policies", "figures", "inspection", "api"),
}
"""What a newcomer needs. Below the fence are extras, and nothing above knows of them."""
BELOW = {"car", "simulated_car", "export", "visual", "proof"}
ALLOWED = {  # a part of the package and what it may import of ours, beside itself
    "core": set(),
    "core.keys": set(),
    "core.parameters": {"core.keys"},
    "core.vehicle": {"core.keys", "core.parameters"},
    "core.longitudinal": set(),
    "core.car_file": {"core.config", "core.longitudinal", "core.vehicle"},
    "core.config": {"core.option_values", "core.trust", "core.files"},
    "core.option_values": set(),
    "core.trust": {"core.reads"},
    "core.extras": set(),
    "core.reads": set(),
    "core.question": {"core.reads", "__version__"},
    "core.files": set(),
    "core.stepping": set(),
    "core.kernels": {"core.config"},
    "core.run_log": {"core.files", "core.extras"},
    "jobs": {"core.files", "core.question", "core.reads", "core.extras"},
    "recordings": GROUND,
    "simulators.learned": GROUND | {"recordings", "simulators.base"},
    "simulators.surrogate": GROUND | {"simulators"},
    "simulators": GROUND | {"recordings"},
    "effects": GROUND,
    "task.paths": GROUND,
    "task.transforms": GROUND | {"task.paths"},
    "task": SIMULATION,
    "inspection": SIMULATION | {"figures"},
    "estimation": SIMULATION,
    "diagnosis.report": SIMULATION | {"estimation", "diagnosis", "figures"},
    "diagnosis": SIMULATION | {"estimation"},
    "policies": SIMULATION | {"core.run_log"},
    "figures": SIMULATION | {"policies"},
    "api": ABOVE,
    "car": set(),
    "simulated_car": SIMULATION | {"car"},
    "export": SIMULATION | {"policies", "car"},
    "visual": ABOVE | {"car", "export"},
    "proof": ABOVE,
    "commands": {*ABOVE, *BELOW, "__version__"},  # for whoever types a command: above all else
    "__main__": {"commands", "core.config"},
}
DOORS = {  # through the fence, each opened where the extra is there
    "policies.people": ("car",),  # people drive by the car's own devices
    "policies.human_table": ("car.clock",),
    "diagnosis.report.figures": ("visual.film",),
}
# Beside these, no simulator knows of another.
SHARED_BY_SIMULATORS = (
    *("simulators.base", "simulators.resets"),
    *("simulators.bicycle.longitudinal", "simulators.bicycle.parameters"),
)
ONLY_IN = {  # a library and the modules that may import it
    "matplotlib": ("figures", "visual", "proof.page", "proof.transfer.page"),
    "mujoco": ("simulators.mujoco", "visual", "proof.baselines.sysid"),
    "dm_control": ("simulators.mujoco", "visual"),
    "mujoco_warp": ("simulators.mujoco.warp_cars",),
    "warp": ("simulators.mujoco.warp_cars",),
    "ray": ("jobs.on_ray", "policies.training.collecting"),
    "submitit": ("jobs.on_submitit",),
    "optuna": ("policies.training.sweep",),
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
    """What a module of the package, such as `simulators.learned`, imports against the rules."""
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
    if part == "simulators" and within(inner, ["simulators"]):
        own, theirs = (f"{place}..".split(".")[1] for place in (module, inner))
        return own == theirs or own == "" or within(inner, SHARED_BY_SIMULATORS)
    if within(inner, DOORS.get(module, ())):
        return True
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
        ("simulators.serial", "from buggy_rl.task.transforms.waypoints import Waypoints"),
        ("simulators.serial", "from buggy_rl.task import env"),
        (
            "simulators.learned",
            "from buggy_rl.simulators.bicycle.single_track import SingleTrackEngine",
        ),
        ("simulators.reference.tyres", "from buggy_rl.simulators.mujoco import tyres"),
        ("simulators.surrogate", "from buggy_rl.effects.base import Effect"),
        ("simulators.reference", "from buggy_rl.simulators.surrogate import SurrogateEngine"),
        ("task.transforms.observation", "import buggy_rl.effects.motion"),
        ("core.vehicle", "from buggy_rl.recordings.windows import windows"),
        ("core.keys", "from buggy_rl.core import parameters"),
        ("simulators.learned.networks", "from buggy_rl.task import env"),
        ("estimation.table", "def f():\n    import matplotlib.pyplot as plt"),
        ("simulators.reference", "from dm_control import mjcf"),
        ("car.runtime", "import torch"),
        ("car.runtime", "from buggy_rl.core.vehicle import rotate"),
        ("car.runtime", "import smbus2"),
        ("policies.training.ppo", "import scripts.train_policy"),
        ("policies.training.run", "from buggy_rl.visual.film import film"),
        ("toolbox", "import math"),
    ],
)
def test_a_planted_violation_is_caught(module, line):
    assert len(faults(module, line)) == 1


@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("simulators.serial", "from buggy_rl.simulators.base import Engine"),
        (
            "simulators.mujoco.engine",
            "from buggy_rl.simulators.mujoco.car import Car\nimport mujoco",
        ),
        ("diagnosis.report", "from buggy_rl.figures.style import svg"),
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


TWINS = {  # classes of the car's runtime that do in numpy what those of the task do, by their names
    *("ActionSmoothing", "ClipVelocity", "CommandFilter", "LastAction", "Observation"),
    *("PastMean", "RateLimit", "Waypoints", "Policy", "HumanConfig"),
}


def test_a_public_function_or_class_has_one_name_in_one_part():
    places = {}
    for module, source in modules():
        for node in ast.parse(source).body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name[0] != "_":
                places.setdefault(node.name, set()).add(module.partition(".")[0])
    several = {name for name, parts in places.items() if len(parts) > 1}
    assert several - {"main"} == TWINS  # `main` is where a process begins
