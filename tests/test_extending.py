"""The code of docs/extending.md: each part takes one file and one line, and then does its work."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import Compose, TransformedEnv
from torchrl.envs.utils import check_env_specs

from buggy_rl.core import keys
from buggy_rl.core.stepping import trajectory
from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.diagnosis.pipeline import run_diagnosis
from buggy_rl.effects import make_effect
from buggy_rl.recordings import Recording
from buggy_rl.recordings.camera import Camera
from buggy_rl.simulators import make_engine
from buggy_rl.task.transforms import make_transform

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "extending.md").read_text()
FILES = dict(re.findall(r"File\s`([^`]+)`:\n\n```python\n(.*?)```", PAGE, re.S))
LINES = re.findall(
    r"Line in `([^`]+)`, in `\w+` behind `(\w+)`[^`]*?:\n\n```python\n(.*?)```", PAGE, re.S
)
NEW = {  # name of each part of the page -> the contract tests that must run over it
    "steering_expo": "tests/contracts/test_effects.py",
    "friction_circle": "tests/contracts/test_engines.py",
    "throttle_cap": "tests/contracts/test_transforms.py",
    "affine": "tests/simulators/learned/test_models.py",
}
EXPO = 0.5
DRIVES, ROWS = 3, 600


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """A copy of the package with the files and lines of the page."""
    source = tmp_path_factory.mktemp("extended") / "src"
    shutil.copytree(ROOT / "src" / "buggy_rl", source / "buggy_rl")
    for path, code in FILES.items():
        (source.parent / path).write_text(code)
    for path, behind, line in LINES:
        file = source.parent / path
        text = file.read_text()
        assert line.count("\n") == 1
        extended = re.sub(rf'^    "{behind}": .*\n', rf"\g<0>{line}", text, flags=re.M)
        assert extended.count("\n") == text.count("\n") + 1
        file.write_text(extended)
    return source


def own(tmp_path, name):
    """Writes a file of the page outside of the package; returns what names its class."""
    (code,) = (code for path, code in FILES.items() if Path(path).stem == name)
    file = tmp_path / f"{name}.py"
    file.write_text(code)
    last = re.findall(r"^class (\w+)", code, re.M)[-1]
    return f"{file}:{last}"


def test_each_part_of_the_page_is_one_file_and_one_line():
    assert len(FILES) == len(LINES) == len(NEW)
    assert sorted(re.findall(r'"(\w+)"', line)[0] for _, _, line in LINES) == sorted(NEW)


MADE = """
from buggy_rl.effects import make_effect
from buggy_rl.simulators import make_engine
from buggy_rl.simulators.learned.factory import ModelConfig, make_model
from buggy_rl.task.transforms import make_transform

for one in (
    make_effect("steering_expo"),
    make_engine("friction_circle", 2),
    make_transform("throttle_cap"),
    make_model(ModelConfig("affine")),
):
    print(type(one).__module__)
"""


def test_with_one_file_and_one_line_each_part_is_made_by_its_name(package):
    environment = os.environ | {"PYTHONPATH": str(package)}
    command = [sys.executable, "-c", MADE]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    files = {f"src/{module.replace('.', '/')}.py" for module in done.stdout.split()}
    assert files == set(FILES)


@pytest.mark.slow  # a pytest in this one, of 300 tests
def test_with_one_file_and_one_line_the_contract_tests_run_over_it_and_pass(package):
    command = [sys.executable, "-m", "pytest", "-v", "-p", "no:cacheprovider", "-p", "no:xdist"]
    command += ["-k", " or ".join(NEW), *NEW.values(), "tests/contracts/test_devices.py"]
    environment = os.environ | {"PYTHONPATH": str(package)}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:]
    for name, file in NEW.items():
        passed = re.findall(rf"^{file}::\w+\[.*{name}.*\] PASSED", done.stdout, re.M)
        assert len(passed) >= 5, name


@pytest.mark.slow
def test_a_diagnosis_names_a_users_own_effect(tmp_path):
    name = own(tmp_path, "expo")
    config = DiagnosisConfig(
        simulator="single_track",
        recordings=[],
        output="",
        effects=[name, "steering_dead_time", "viscous_drag"],
        parameters=False,
        stretches=8,
        minutes=0.0,
        workers=1,
    )
    found = run_diagnosis(config, recorded(name)).answer
    assert found.verdict == "missing_physics"
    assert [effect.name for effect in found.effects] == [name]
    assert found.effects[0].parameters["expo"].value == pytest.approx(EXPO, abs=0.05)
    assert found.effects[0].equation.startswith("steering' = (1 - expo) steering")


def recorded(effect):
    """Recordings of a simulated car that has the effect: commands held for 0.45 s each."""
    effects = Compose(make_effect(effect, {"expo": EXPO}))  # type: ignore[arg-type]
    env = TransformedEnv(make_engine("single_track", DRIVES), effects)
    knots = torch.rand(DRIVES, ROWS // 45 + 1, 2, generator=torch.Generator().manual_seed(0))
    low, high = torch.tensor([-0.5, -0.8]), torch.tensor([0.1, 0.8])
    action = (low + (high - low) * knots).repeat_interleave(45, 1)
    states = list(trajectory(env, env.reset(), lambda k, s: s.set(keys.ACTION, action[:, k]), ROWS))
    rows = [s.select(keys.POSE, keys.VELOCITY, keys.ACTION).clone() for s in states[:-1]]
    true: TensorDictBase = TensorDict.stack(rows, 1)  # type: ignore[assignment]
    return [Recording(f"drive_{i}", Camera(None, i).recorded(true[i]), 0.01) for i in range(DRIVES)]


def test_a_users_own_engine_and_transform_are_taken_by_their_files(tmp_path):
    engine = make_engine(own(tmp_path, "friction_circle"), 3)
    cap = make_transform(own(tmp_path, "throttle_cap"), {"cap": -0.5})
    env = TransformedEnv(engine, cap)
    check_env_specs(env)
    state = env.reset()
    state[keys.ACTION] = torch.tensor([[-0.5, 0.0], [0.0, 0.0], [1.0, 0.0]])
    velocity = env.step(state)["next", keys.VELOCITY]
    # 5 m/s^2 at a drive of 0.25 for 10 ms, whatever more is asked for
    torch.testing.assert_close(velocity[:, 0], torch.full((3,), 0.0125))
