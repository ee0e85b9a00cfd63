"""Simulators that are made from drives of the right car, with scripts that tell what they got."""

import pytest

from buggy_rl.blind_test import preparation
from buggy_rl.blind_test.case import Case
from buggy_rl.blind_test.preparation import DRIVES, needed, prepare
from buggy_rl.recordings import load_recordings

SCRIPT = """
import pathlib, sys
told = dict(argument.split("=", 1) for argument in sys.argv[1:])
if told.get("fit_simulator") == "kinematic":
    sys.exit("kinematic cannot be fitted")
made = pathlib.Path(told["output"]) / "{made}"
made.parent.mkdir(parents=True)
made.write_text("engine: mujoco")
(made.parent / "told").write_text(told["data.recordings"])
"""


@pytest.fixture(scope="module")
def scripts(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scripts")
    (folder / "fit_mujoco.py").write_text(SCRIPT.format(made="mujoco_fitted.yaml"))
    (folder / "train_models.py").write_text(SCRIPT.format(made="models/model.pt"))
    return folder


@pytest.fixture(autouse=True)
def short(monkeypatch):
    monkeypatch.setattr(preparation, "SECONDS", 1.2)


def test_each_simulator_is_prepared_once_for_each_plant(scripts, tmp_path):
    fitted = [
        Case(n, plant, "mujoco_fitted", True, {"payload": {"mass_ratio": 1.4}})
        for n, plant in enumerate(("mujoco", "mujoco", "commonroad"))
    ]
    assert [case.seed for case in needed([Case(9, "mujoco", "mujoco"), *fitted], tmp_path)] == [
        1,
        2,
    ]
    assert prepare(fitted[0], tmp_path, scripts).name == "mujoco_mujoco_fitted.yaml"
    assert [case.seed for case in needed(fitted, tmp_path)] == [2]
    learned = Case(4, "mujoco", "learned", True)
    assert prepare(learned, tmp_path, scripts).name == "mujoco_learned.pt"
    assert needed([learned, *fitted[:2]], tmp_path) == []
    drives, refusals = load_recordings([str(tmp_path / "mujoco_drives")])
    assert (len(drives), refusals) == (DRIVES, [])
    told = (tmp_path / "mujoco_mujoco_fitted_study" / "told").read_text()
    assert told == f"[{tmp_path / 'mujoco_drives'}]"


def test_a_script_that_fails_says_why(scripts, tmp_path):
    with pytest.raises(RuntimeError, match="kinematic cannot be fitted"):
        prepare(Case(1, "mujoco", "kinematic_fitted", True), tmp_path, scripts)
    assert needed([Case(1, "mujoco", "kinematic_fitted", True)], tmp_path)
