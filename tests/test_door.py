"""The names of `buggy_rl` itself: light to import, all there, and described in docs/api.md."""

import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest

import buggy_rl

PAGE = (Path(__file__).parents[1] / "docs" / "api.md").read_text()
NAMES = [name for name in buggy_rl.__all__ if name != "__version__"]
MOST = 30  # names: more would be no door


def test_importing_it_costs_no_torch_and_no_time():
    code = (
        "import sys, time\nbegin = time.process_time()\nimport buggy_rl\n"
        "assert time.process_time() - begin < 0.3\n"
        "heavy = {'torch', 'tensordict', 'pandas', 'mujoco', 'omegaconf'} & set(sys.modules)\n"
        "assert not heavy, heavy\nassert 'diagnose' in dir(buggy_rl)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_there_are_few_names_sorted_and_known_to_editors():
    assert len(NAMES) <= MOST
    assert sorted(NAMES) == NAMES
    source = Path(buggy_rl.__file__).read_text()
    assert set(re.findall(r"^    from buggy_rl\S* import (\w+) as \1$", source, re.M)) == set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_a_name_is_there_says_what_it_does_and_is_on_the_page(name):
    found = getattr(buggy_rl, name)
    assert found.__name__ == name
    assert inspect.getdoc(found)
    assert re.search(rf"^\| `{name}[(`]", PAGE, re.M), f"docs/api.md has no row for {name}"


def test_the_page_has_no_row_for_what_is_not_there():
    assert set(re.findall(r"^\| `(\w+)", PAGE, re.M)) == set(NAMES)


def test_the_page_names_the_arguments_that_functions_take():
    rows = dict(re.findall(r"^\| `(\w+)\((.*?)\)`", PAGE, re.M))
    assert {"diagnose", "fit", "evaluate", "train_model", "train_policy"} <= set(rows)
    for name, arguments in rows.items():
        known = inspect.signature(getattr(buggy_rl, name)).parameters
        own = [a.strip().partition("=")[0].lstrip("*") for a in arguments.split(",")]
        assert [a for a in own if a and a not in known and a != "..."] == [], name


def test_the_page_lists_every_method_of_a_diagnosis():
    own = {n for n, _ in inspect.getmembers(buggy_rl.Diagnosis) if not n.startswith("_")}
    listed = set(re.findall(r"^- `\.(\w+)", PAGE, re.M))
    assert listed == own


def test_a_name_that_is_not_there_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'diagnoze'"):
        buggy_rl.diagnoze  # noqa: B018


def test_the_examples_of_the_page_are_python():
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S)
    assert blocks
    for block in blocks:
        for name in re.findall(r"buggy_rl\.(\w+)", block):
            assert name in NAMES
        compile(block, "docs/api.md", "exec")
