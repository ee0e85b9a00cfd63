"""Who may import whom, read off the source: the plan of the house, kept true."""

import ast
import sys
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src" / "buggy_rl"

GROUND = {"keys", "parameters", "vehicle", "config"}
DATA = GROUND | {"recordings", "paths", "camera", "dataset"}
SIMULATION = DATA | {"models", "engines", "effects", "transforms", "env"}
JUDGEMENT = SIMULATION | {"drivers", "policy", "evaluation", "residuals", "fitting"}
ALLOWED = {
    "keys": set(),
    "parameters": {"keys"},
    "vehicle": {"keys", "parameters"},
    "config": {"keys", "parameters"},
    "recordings": GROUND,
    "paths": GROUND,
    "camera": GROUND,
    "dataset": GROUND | {"recordings"},
    "models": DATA,
    "engines": DATA | {"models"},
    "effects": GROUND | {"paths"},
    "transforms": GROUND | {"paths"},
    "env": SIMULATION,
    "gym": SIMULATION,
    "courses": GROUND | {"paths", "env"},
    "marshal": GROUND | {"transforms"},
    "driving": GROUND | {"transforms", "marshal"},
    "drivers": GROUND | {"paths", "camera", "transforms", "env", "driving"},
    "policy": GROUND | {"transforms", "env"},
    "checkpoint": GROUND,
    "episodes": GROUND | {"transforms"},
    "clipped_loss": GROUND,
    "ppo": SIMULATION | {"drivers", "policy", "checkpoint", "episodes", "clipped_loss"},
    "policy_tables": SIMULATION | {"courses", "driving", "policy"},
    "policy_run": SIMULATION | {"driving", "policy", "ppo", "checkpoint"},
    "policy_drives": SIMULATION | {"courses", "driving", "drivers", "policy", "policy_run"},
    "driver_tables": SIMULATION | {"courses", "driving", "drivers", "policy_run"},
    "learning_curves": set(),
    "evaluation": SIMULATION | {"drivers", "policy"},
    "residuals": JUDGEMENT,
    "fitting": JUDGEMENT,
    "comparison": JUDGEMENT,
    "study": JUDGEMENT | {"comparison"},
    "visual": JUDGEMENT | {"comparison", "policy_drives", "learning_curves"},
    "diagnosis": JUDGEMENT,
    "proving": JUDGEMENT | {"diagnosis", "visual"},
    "transfer": JUDGEMENT | {"courses", "driving", "marshal", "policy_tables", "proving", "visual"},
    "car": set(),
}
SHARED_BY_ENGINES = {"base", "actuation", "rows"}  # beside these, none knows of another
ONLY_IN = {  # a library and the modules that may import it
    "matplotlib": ("diagnosis.report", "visual", "proving.pictures", "transfer.pictures"),
    "mujoco": ("engines.mujoco", "visual", "proving.baselines.sysid"),
    "dm_control": ("engines.mujoco", "visual"),
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


def faults(module, source):
    """What a module of the package, such as `engines.hold`, imports against the rules."""
    part = module.partition(".")[0]
    if part not in ALLOWED:
        return [f"{module}: {part} is not in the table of who may import whom"]
    return [f"{module} imports {name}" for name in imports(source) if not allowed(module, name)]


def allowed(module, name):
    top, _, inner = name.partition(".")
    part = module.partition(".")[0]
    if top == "scripts":
        return False
    if top in ONLY_IN:
        return within(module, ONLY_IN[top])
    if top != "buggy_rl":
        return part != "car" or top == "numpy" or top in sys.stdlib_module_names
    other = inner.partition(".")[0]
    if part == "engines" == other:
        own, theirs = (f"{place}..".split(".")[1] for place in (module, inner))
        return own == theirs or own == "" or theirs in SHARED_BY_ENGINES
    return other == part or other in ALLOWED[part]


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
        ("engines.hold", "from buggy_rl.transforms.waypoints import Waypoints"),
        ("engines.hold", "from buggy_rl import env"),
        ("engines.hold", "from buggy_rl.engines.single_track import SingleTrackEngine"),
        ("engines.reference.tyres", "from buggy_rl.engines.mujoco import tyres"),
        ("transforms.history", "import buggy_rl.effects.motion"),
        ("vehicle", "from buggy_rl.dataset import windows"),
        ("keys", "from buggy_rl import parameters"),
        ("models.mlp", "from buggy_rl.engines import make_engine"),
        ("evaluation", "def f():\n    import matplotlib.pyplot as plt"),
        ("engines.reference", "from dm_control import mjcf"),
        ("car.runtime", "import torch"),
        ("car.runtime", "from buggy_rl.vehicle import rotate"),
        ("ppo", "import scripts.train_policy"),
        ("toolbox", "import math"),
    ],
)
def test_a_planted_violation_is_caught(module, line):
    assert len(faults(module, line)) == 1


@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("engines.hold", "from buggy_rl.engines.base import Engine"),
        ("engines.mujoco.engine", "from buggy_rl.engines.mujoco.car import Car\nimport mujoco"),
        ("diagnosis.report", "import matplotlib.pyplot as plt"),
        ("car.runtime", "import numpy as np, json\nfrom buggy_rl.car.watchdog import Watchdog"),
    ],
)
def test_an_honest_import_is_not(module, line):
    assert faults(module, line) == []
