"""What two results must agree in to answer the same question."""

import subprocess
import sys
from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict

from buggy_rl.core.question import contents, difference, key, question, refuse_another
from buggy_rl.core.reads import files_read
from buggy_rl.recordings import Recording


@pytest.fixture
def simulator(tmp_path, monkeypatch):
    """A user's simulator of several files; the working folder is another one."""
    folder = tmp_path / "sim"
    (folder / "lib").mkdir(parents=True)
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    (folder / "my.py").write_text(
        "import math, torch\nfrom physics import MASS\nfrom lib.tyres import grip\n"
        "from buggy_rl.simulators.base import HoldEngine\nTABLE = 'table.csv'\nLOG = 'calls.log'\n"
    )
    (folder / "physics.py").write_text("from constants import G\nMASS = 3.0\n")
    (folder / "constants.py").write_text("G = 9.8\n")
    (folder / "lib" / "__init__.py").write_text("")
    (folder / "lib" / "tyres.py").write_text("from . import more\n\ndef grip():\n    import late\n")
    (folder / "lib" / "more.py").write_text("")
    (folder / "lib" / "late.py").write_text("")
    (folder / "table.csv").write_text("1,2\n")
    (folder / "calls.log").write_text("it writes this one\n")
    (folder / "car.yaml").write_text("engine: single_track\noptions: {car: mine.yaml}\n")
    (folder / "mine.yaml").write_text("dimensions: {mass: 3.0}\n")
    (folder / "repaired.yaml").write_text(
        "engine: car.yaml\neffects:\n  residual_acceleration: {model: correction.pt}\n"
        "  ../sim/effect.py:Bump: {height: 0.1}\n"
    )
    (folder / "correction.pt").write_bytes(b"weights")
    (folder / "effect.py").write_text("import physics\n")
    return folder


def names(files):
    return {f"{file.parent.name}/{file.name}" for file in files}


def test_modules_of_the_users_own_are_found_through_others(simulator):
    assert names(files_read(f"{simulator}/my.py:make")) == {
        *("sim/my.py", "sim/physics.py", "sim/constants.py", "lib/__init__.py", "lib/tyres.py"),
        *("lib/more.py", "lib/late.py", "sim/table.csv"),
    }


def test_files_that_a_simulator_file_names_are_found_through_others(simulator):
    assert names(files_read(str(simulator / "repaired.yaml"))) == {
        *("sim/repaired.yaml", "sim/car.yaml", "sim/mine.yaml", "sim/correction.pt"),
        *("sim/effect.py", "sim/physics.py", "sim/constants.py"),
    }


def test_a_module_on_the_path_is_found_and_not_imported(simulator, monkeypatch):
    monkeypatch.syspath_prepend(str(simulator))
    assert "lib/tyres.py" in names(files_read("lib.tyres:make"))
    assert "lib.tyres" not in sys.modules


@pytest.mark.parametrize("name", ["mujoco", "os:system", "tqdm.std:tqdm", "nowhere.py:make", ""])
def test_what_is_not_the_users_own_has_no_files(name):
    assert files_read(name) == []


@pytest.mark.parametrize("file", ["my.py", "constants.py", "lib/more.py", "table.csv"])
def test_every_file_that_is_read_changes_the_key_and_is_named(simulator, file):
    settings = {"engine": {"simulator": f"{simulator}/my.py:make"}}
    before = question(settings)
    assert question(settings) == before
    (simulator / file).write_text("# another\n" + (simulator / file).read_text())
    after = question(settings)
    assert key(before) != key(after)
    assert difference(before, after).startswith(f"{file} has other content now")


def test_a_file_that_is_written_is_no_part_of_the_question(simulator):
    before = question({"simulator": f"{simulator}/my.py:make"})
    (simulator / "calls.log").write_text("more\n")
    assert question({"simulator": f"{simulator}/my.py:make"}) == before


def test_a_moved_folder_is_no_other_question(simulator):
    before = question({"simulator": f"{simulator}/my.py:make"})
    moved = simulator.rename(simulator.parent / "moved")
    assert question({"simulator": f"{moved}/my.py:make"}) == before


def test_another_setting_is_named_with_both_values():
    before = question({"ppo": {"learning_rate": 0.003, "steps": 10}, "seed": 1})
    after = question({"ppo": {"learning_rate": 0.001, "steps": 20}, "seed": 1})
    said = "ppo.learning_rate was 0.003, now 0.001; ppo.steps was 10, now 20"
    assert difference(before, after) == said
    with pytest.raises(ValueError, match=f"^x.pt answers another question: {said}; begin anew$"):
        refuse_another(before, after, "x.pt", "begin anew")
    assert question({"a": 1, "b": {"c": 2, "d": 3}}, ignoring=["b.c"]) == {"a": 1, "b.d": 3}


def test_recordings_count_by_their_content_in_their_part():
    data = TensorDict({"pose": torch.zeros(5, 3), "t": torch.zeros(5, 1).double()}, [5])
    first = Recording("drive", data, 0.01, source="a/drive.csv")
    other = replace(first, data=data.clone())
    assert contents([first]) == contents([replace(other, source="b/drive.csv")])
    other.data["pose"][2, 1] = 1e-6
    said = difference(contents([first]), contents([other]))
    assert said == "recording drive has other content now"
    assert difference(contents([first]), contents([first], "baseline recording"))
    assert len(contents([first, other])) == 2  # of one name


def test_the_key_does_not_depend_on_the_process(simulator):
    code = (
        "from buggy_rl.core.question import *; import sys;"
        "print(key(question({'simulator': sys.argv[1], 'x': [1.5, None, True]})))"
    )
    name = f"{simulator}/my.py:make"
    found = {
        subprocess.run(
            [sys.executable, "-c", code, name], capture_output=True, text=True, check=True
        ).stdout.strip()
        for _ in range(2)
    }
    assert found == {key(question({"simulator": name, "x": [1.5, None, True]}))}
