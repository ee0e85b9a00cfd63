"""No step of the wall clock reaches control: nothing reads it but the label of a recording."""

import ast
from pathlib import Path

import pytest

CAR = Path(__file__).parents[2] / "src" / "buggy_rl" / "car"
WALL = {"time", "strftime", "localtime", "gmtime", "ctime", "time_ns"}  # of the module time
MODULES = {"datetime", "calendar"}


def wall_clock_uses(source):
    """Functions that read the wall clock, as names of what is called or imported."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            if node.value.id == "time" and node.attr in WALL:
                found.append(f"time.{node.attr}")
        elif isinstance(node, ast.Import):
            found += [alias.name for alias in node.names if alias.name in MODULES]
        elif isinstance(node, ast.ImportFrom) and node.module in {*MODULES, "time"}:
            found.append(node.module)
    return found


def test_only_the_label_of_a_recording_reads_the_wall_clock():
    uses = {file.name: wall_clock_uses(file.read_text()) for file in CAR.rglob("*.py")}
    assert {name: found for name, found in uses.items() if found} == {"clock.py": ["time.strftime"]}


@pytest.mark.parametrize(
    "line", ["import time\nt = time.time()", "from time import time", "import datetime"]
)
def test_a_planted_use_is_found(line):
    assert wall_clock_uses(line)


def test_the_monotonic_clock_is_not_one():
    assert not wall_clock_uses("import time\nt = time.monotonic()\ntime.sleep(1)")
