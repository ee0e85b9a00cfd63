"""What the tool is told of the simulator."""

import pytest
import yaml

from buggy_rl.blind_test.case import Case
from buggy_rl.blind_test.question import off, prepared_name, question, simulator_content
from buggy_rl.engines import make_engine


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
    told = yaml.safe_load(question(Case(5, "reference", "mujoco_fitted", True), []))
    assert told == {
        "simulator": "simulator.yaml",
        "recordings": ["recordings"],
        "baseline": ["baseline"],
        "stretches": 60,  # MuJoCo takes its time
    }
    # The reference car shows no parameters: it is asked as a black box.
    assert yaml.safe_load(question(Case(5, "reference", "reference"), ["wind"])) == {
        "simulator": "simulator.yaml",
        "recordings": ["recordings"],
        "parameters": False,
        "effects": ["wind"],
    }
