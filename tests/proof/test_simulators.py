"""The simulators of cases: what the diagnosis is told of them, and how they are prepared."""

import pytest
import yaml

from buggy_rl.proof.cases import simulators
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.drives import plant_parameters
from buggy_rl.proof.cases.simulators import (
    DRIVES,
    diagnosis_options,
    off,
    prepare,
    prepared_name,
    simulator_content,
    unprepared,
)
from buggy_rl.recordings import load_recordings
from buggy_rl.simulators import make_engine

SCRIPT = """
import pathlib, sys
told = dict(argument.split("=", 1) for argument in sys.argv[1:])
if told.get("fit_simulator") == "kinematic":
    sys.exit("kinematic cannot be fitted")
made = pathlib.Path(told["output"]) / "{made}"
made.parent.mkdir(parents=True, exist_ok=True)
made.write_text("engine: mujoco")
(made.parent / "told").write_text(told["data.recordings"])
"""


def test_parameters_are_off_by_the_share_that_is_said_up_or_down(tmp_path):
    case = Case(5, "mujoco", "mujoco", True, nuisance="parameters_10")
    told = simulator_content(case, tmp_path)["parameters"]
    ratios = set()
    for name, parameter in make_engine("mujoco", 1).declared.items():
        if parameter.value:
            assert parameter.lower <= told[name] <= parameter.upper
            ratios.add(round(told[name] / parameter.value, 4))
    assert {0.9, 1.1} <= ratios


def test_a_parameter_stays_within_what_it_may_be():
    told = off({"engine": "reference", "parameters": {"initial_charge": 1.0}}, 0.1, 1)
    seen = {off({"engine": "reference", "parameters": {"initial_charge": 1.0}}, 0.1, s)[
        "initial_charge"
    ] for s in range(9)}  # fmt: skip
    assert told["mass"] in (pytest.approx(1.625 * 0.9), pytest.approx(1.625 * 1.1))
    assert seen == {0.9, 1.0}


def test_another_integrator_is_the_same_simulator_in_longer_steps(tmp_path):
    case = Case(5, "mujoco", "mujoco", nuisance="integrator")
    content = simulator_content(case, tmp_path)
    assert content == {"engine": "mujoco", "options": {"timestep": 0.005}}
    assert len(make_engine("mujoco", 2, **content["options"]).batch_size) == 1


def test_a_fitted_simulator_is_told_without_what_the_fit_says_of_itself(tmp_path):
    case = Case(5, "reference", "mujoco_fitted", True)
    assert prepared_name(case) == "reference_mujoco_fitted"
    fitted = {"engine": "mujoco", "parameters": {"mass": 1.5}, "_fit": {"mass": {"low": 1.4}}}
    (tmp_path / "reference_mujoco_fitted.yaml").write_text(yaml.safe_dump(fitted))
    told = simulator_content(case, tmp_path)
    assert told == {"engine": "mujoco", "parameters": {"mass": 1.5}}


def test_a_question_names_folders_and_nothing_else():
    told = yaml.safe_load(diagnosis_options(Case(5, "reference", "mujoco_fitted", True), []))
    assert told == {
        "simulator": "simulator.yaml",
        "recordings": ["recordings"],
        "baseline": ["baseline"],
        "stretches": 60,  # MuJoCo takes its time
    }
    # The reference car shows no parameters: it is asked as a black box.
    assert yaml.safe_load(diagnosis_options(Case(5, "reference", "reference"), ["wind"])) == {
        "simulator": "simulator.yaml",
        "recordings": ["recordings"],
        "parameters": False,
        "effects": ["wind"],
    }


@pytest.fixture(scope="module")
def scripts(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scripts")
    (folder / "fit_mujoco.py").write_text(SCRIPT.format(made="mujoco_fitted.yaml"))
    (folder / "train_models.py").write_text(SCRIPT.format(made="models/model.pt"))
    return folder


@pytest.fixture(autouse=True)
def short(monkeypatch):
    monkeypatch.setattr(simulators, "SECONDS", 1.2)


def test_each_simulator_is_prepared_once_for_each_plant(scripts, tmp_path):
    fitted = [
        Case(n, plant, "mujoco_fitted", True, {"payload": {"mass_ratio": 1.4}})
        for n, plant in enumerate(("mujoco", "mujoco", "commonroad"))
    ]
    assert [case.seed for case in unprepared([Case(9, "mujoco", "mujoco"), *fitted], tmp_path)] == [
        1,
        2,
    ]
    assert prepare(fitted[0], tmp_path, scripts).name == "mujoco_mujoco_fitted.yaml"
    assert [case.seed for case in unprepared(fitted, tmp_path)] == [2]
    learned = Case(4, "mujoco", "learned", True)
    assert prepare(learned, tmp_path, scripts).name == "mujoco_learned.pt"
    assert unprepared([learned, *fitted[:2]], tmp_path) == []
    drives, refusals = load_recordings([str(tmp_path / "mujoco_drives")])
    assert (len(drives), refusals) == (DRIVES, [])
    told = (tmp_path / "mujoco_mujoco_fitted_study" / "told").read_text()
    assert told == f"[{tmp_path / 'mujoco_drives'}]"


def test_a_script_that_fails_says_why(scripts, tmp_path):
    with pytest.raises(ValueError, match="kinematic cannot be fitted"):
        prepare(Case(1, "mujoco", "kinematic_fitted", True), tmp_path, scripts)
    assert unprepared([Case(1, "mujoco", "kinematic_fitted", True)], tmp_path)


def test_a_drawn_plants_own_simulator_is_of_the_same_numbers(tmp_path):
    case = Case(5, "mujoco", "mujoco", spread=0.1)
    told = simulator_content(case, tmp_path)["parameters"]
    assert told == pytest.approx(plant_parameters(case), abs=1e-7)
    wrong = Case(5, "mujoco", "mujoco", True, nuisance="parameters_10", spread=0.1)
    ratios = {
        round(value / told[name], 3)
        for name, value in simulator_content(wrong, tmp_path)["parameters"].items()
        if told[name]
    }
    assert {0.9, 1.1} <= ratios


def test_a_drawn_plant_is_fitted_anew_to_its_own_drives(tmp_path):
    for made in ("single_track_fitted.yaml",):
        (tmp_path / "fit_mujoco.py").write_text(SCRIPT.format(made=made))
    usual = Case(5, "reference", "single_track_fitted")
    drawn = Case(5, "reference", "single_track_fitted", spread=0.1)
    assert prepared_name(usual) != prepared_name(drawn)
    assert len(unprepared([usual, drawn], tmp_path)) == 2
    prepare(drawn, tmp_path, tmp_path)
    assert unprepared([usual, drawn], tmp_path) == [usual]
    told = (tmp_path / f"{prepared_name(drawn)}_study" / "told").read_text()
    assert told == f"[{tmp_path / f'{prepared_name(drawn)}_drives'}]"
