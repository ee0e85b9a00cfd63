"""Files that are handed on and try to run code of their own."""

import os
import pickle
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from buggy_rl.core import trust
from buggy_rl.core.config import build, plain_values
from buggy_rl.effects import effect_class, make_effects
from buggy_rl.effects.residual_models import load_residual
from buggy_rl.policies.training.actor_critic import Policy, load_policy, save_policy
from buggy_rl.policies.training.checkpoint import load_checkpoint
from buggy_rl.policies.training.run import PolicyRunConfig, task_of, training_engine
from buggy_rl.simulators import make_engine
from buggy_rl.simulators.learned.factory import load_model
from buggy_rl.task.env import make_simulator
from buggy_rl.task.transforms import make_transform

CODE = "open({ran!r}, 'w').write('ran')\n\n\ndef make(batch_size, device):\n    return 1\n"


@pytest.fixture
def ran(tmp_path):
    """A file that appears when an attack has succeeded."""
    return tmp_path / "ran"


@pytest.fixture
def elsewhere(tmp_path, ran, monkeypatch):
    """A folder with code that nobody has looked at; the working folder is another one."""
    folder, here = tmp_path / "download", tmp_path / "here"
    folder.mkdir()
    here.mkdir()
    (folder / "code.py").write_text(CODE.format(ran=str(ran)))
    monkeypatch.chdir(here)
    monkeypatch.delenv(trust.TRUSTED, raising=False)
    return folder


def simulator(folder, **content):
    file = folder / "simulator.yaml"
    file.write_text(yaml.safe_dump({"engine": "hold", **content}))
    return file


@pytest.mark.parametrize(
    "content",
    [
        {"engine": "subprocess:getoutput"},
        {"engine": "os:system"},
        {"effects": {"os:system": {"command": "touch {ran}"}}},
        {"effects": {"subprocess:Popen": {"args": "touch {ran}", "shell": True}}},
        {"engine": "code.py:make"},
        {"effects": {"{folder}/code.py:make": {}}},
        {"engine": "pip._internal.cli.main:main"},
        {"effects": {"torch.hub:load": {"repo_or_dir": "{folder}", "model": "code"}}},
        {"engine": "single_track", "effects": {"../download/code.py:make": None}},
        {"engine": "surrogate", "options": {"simulator": "code.py:make", "model": "model.pt"}},
        {"engine": "surrogate", "options": {"simulator": "os:system", "model": "model.pt"}},
    ],
    ids=str,
)
def test_a_simulator_file_runs_nothing_but_what_is_ours(content, elsewhere, ran):
    text = yaml.safe_dump({"engine": "hold", **content})
    text = text.replace("{ran}", str(ran)).replace("{folder}", str(elsewhere))
    (elsewhere / "bad.yaml").write_text(text)
    with pytest.raises(ValueError, match=r"bad\.yaml names"):
        make_simulator(elsewhere / "bad.yaml", 2)
    nested = simulator(elsewhere, engine="bad.yaml")  # neither through another file
    with pytest.raises(ValueError, match=r"bad\.yaml names"):
        make_simulator(nested, 2)
    assert not ran.exists()


@pytest.mark.parametrize(
    "name", ["os:system", "code.py:make", "torchrl.envs:Tokenizer", "torchrl.envs:R3MTransform"]
)
def test_a_policy_file_names_no_code_but_ours(name, elsewhere, ran, tmp_path):
    name = name.replace("code.py", str(elsewhere / "code.py"))
    config = plain_values(build(PolicyRunConfig, ["output=x"]))
    config["task"]["transforms"]["zz"] = {
        "name": name,
        "options": {"command": f"touch {ran}"},
        "before": "",
    }
    config["engine"]["simulator"] = name
    about = {"config": config}
    save_policy(Policy(4), tmp_path / "best.pt", about)
    for read in (training_engine, task_of):
        with pytest.raises(ValueError, match=r"best\.pt names"):
            read(about, tmp_path / "best.pt")
    about["config"]["engine"] |= {"simulator": "surrogate", "options": {"simulator": name}}
    with pytest.raises(ValueError, match=r"best\.pt names"):
        training_engine(about, tmp_path / "best.pt")
    assert not ran.exists()


def test_every_script_that_takes_a_policy_asks_whether_its_code_is_trusted():
    # What reads the record of a policy's training by another way would pass by the check.
    source = Path(trust.__file__).parents[1]
    readers = {
        file.relative_to(source).as_posix()
        for file in source.rglob("*.py")
        for line in file.read_text().splitlines()
        if "from_plain(" in line and ("EngineConfig" in line or "TaskConfig" in line)
    }
    assert readers == {"policies/training/run.py"}


def test_what_lies_below_the_working_folder_is_the_users_own(elsewhere, monkeypatch):
    own = Path("sim.py")
    own.write_text("from buggy_rl.simulators.base import HoldEngine as make\n")
    assert make_simulator(simulator(Path.cwd(), engine="sim.py:make"), 2).batch_size == (2,)
    # Handed on from below the working folder it may also be named from elsewhere.
    away = simulator(elsewhere, engine=os.path.relpath("sim.py:make", elsewhere))
    assert make_simulator(away, 2).batch_size == (2,)
    monkeypatch.chdir(elsewhere)
    with pytest.raises(ValueError, match="outside the working folder"):
        make_simulator(away, 2)


def test_a_folder_that_is_trusted_is_said_on_the_command_line(elsewhere, ran):
    file = simulator(elsewhere, engine="code.py:make")
    with pytest.raises(ValueError, match="outside the working folder") as told:
        make_simulator(file, 2)
    remedy = str(told.value).split("say ")[1].split()[0]
    assert remedy == f"trust={elsewhere}"
    try:
        assert trust.taken(["a.yaml", remedy, "output=x"]) == ["a.yaml", "output=x"]
        with pytest.raises(
            ValueError, match="must return a TorchRL EnvBase"
        ):  # its code runs, and makes no simulator
            make_simulator(file, 2)
        assert ran.exists()
    finally:
        del os.environ[trust.TRUSTED]


def test_an_installed_package_is_trusted_by_its_name(elsewhere, monkeypatch):
    with pytest.raises(ValueError, match="say trust=tqdm"):
        trust.refuse_foreign("tqdm.std:tqdm", "a.yaml")
    monkeypatch.setenv(trust.TRUSTED, "tqdm")
    trust.refuse_foreign("tqdm.std:tqdm", "a.yaml")
    with pytest.raises(ValueError, match="Python's own library"):  # whatever is trusted
        trust.refuse_foreign("os:system", "a.yaml")


def test_packages_of_an_environment_below_the_working_folder_are_not_the_users_own(
    tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    place = tmp_path / ".venv" / "lib" / "site-packages" / "some.py"
    with pytest.raises(ValueError, match="look at it"):
        trust.refuse_foreign(f"{place}:make", "a.yaml")


@pytest.mark.parametrize("name", ["os:system", "builtins:eval", "subprocess:Popen"])
def test_what_is_named_is_of_the_kind_that_is_expected_before_it_is_called(name):
    # On a command line, where a user may name anything.
    with pytest.raises(ValueError, match=r"expected a subclass of buggy_rl\.effects\.base\.Effect"):
        effect_class(name)
    with pytest.raises(ValueError, match=r"expected a subclass of .*Effect"):
        make_effects({name: {"command": "false"}})
    with pytest.raises(ValueError, match=r"expected a subclass of torchrl\..*Transform"):
        make_transform(name, {"command": "false"})
    with pytest.raises(ValueError, match="expected an EnvBase"):
        make_engine(name, 2)


def test_a_model_that_is_a_pickle_of_code_is_not_read(tmp_path, ran):
    class Attack:
        def __reduce__(self):
            return os.system, (f"touch {ran}",)

    (tmp_path / "model.pt").write_bytes(pickle.dumps(Attack()))
    for read in (load_model, load_policy, load_checkpoint, load_residual):
        with pytest.raises(ValueError, match=r"^\S+model\.pt holds more than weights[^\n]*$"):
            read(tmp_path / "model.pt")
    assert not ran.exists()


def test_torchrls_own_transforms_may_be_named():
    for name in ("torchrl.envs:RewardScaling", "torchrl.envs.transforms:VecNormV2", "rewards"):
        trust.refuse_foreign(name, "best.pt")


def test_asking_for_pip_leaves_setuptools_importable():
    code = (
        "from buggy_rl.core.trust import _homes; "
        "assert list(_homes('pip')); import setuptools; print('imported')"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert ran.stdout.strip() == "imported", ran.stderr
