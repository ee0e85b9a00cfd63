"""Importing the package registers the environment, before or after Gymnasium is imported."""

import subprocess
import sys

import pytest

REGISTERED = "assert 'buggy_rl/Waypoints-v0' in gymnasium.registry"


def run(*lines):
    done = subprocess.run([sys.executable, "-c", "\n".join(lines)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    "lines",
    [
        ["import gymnasium, buggy_rl"],
        ["import buggy_rl, gymnasium"],
        ["import importlib.util, buggy_rl", "importlib.util.find_spec('gymnasium')",
         "import gymnasium"],
        ["import gymnasium", "gymnasium.spec", "__import__('buggy_rl')"],
    ],
)  # fmt: skip
def test_the_environment_is_registered_in_either_order_without_torch(lines):
    run(*lines, REGISTERED, "import sys", "assert 'torch' not in sys.modules")


def test_gymnasium_knows_nothing_of_it_before():
    with pytest.raises(AssertionError, match="AssertionError"):
        run("import gymnasium", REGISTERED)


def test_the_package_alone_does_not_import_gymnasium():
    run("import sys, buggy_rl", "assert not {'gymnasium', 'numpy'} & set(sys.modules)")


def test_a_missing_gymnasium_is_missed_by_its_own_name():
    lines = ["import sys, buggy_rl", "sys.path[:] = []", "import gymnasium"]
    with pytest.raises(AssertionError, match="ModuleNotFoundError: No module named 'gymnasium'"):
        run(*lines)
