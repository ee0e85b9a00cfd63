"""An effect that the simulator realises by its parameters has one name, inside and around it."""

from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.diagnosis.pipeline import run_diagnosis
from buggy_rl.diagnosis.repaired import repaired_simulator
from buggy_rl.simulators.serial import in_single_precision
from buggy_rl.task.env import make_simulator
from tests.diagnosis import realising
from tests.diagnosis.planted import planted_drives
from tests.plain_env import MASS, NUMBERS

SIMULATOR = f"{Path(realising.__file__)}:make"
LEAST, FULL = 1e-3, 0.0  # [min] that a diagnosis is given; 0 for as many as it takes
DAMPING, RATE = NUMBERS["motor_damping"], 0.5  # [N s/m], [1/s]


def cars(count):
    return in_single_precision(realising.make(count))


pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def recordings():
    changed = {"parameter": {"motor_damping": DAMPING + RATE * MASS}}
    return planted_drives([changed], seconds=12.0, make=cars)[0]


def config(**more):
    asked = DiagnosisConfig(
        simulator=SIMULATOR,
        recordings=["made in the test"],
        output="nowhere",
        effects=["viscous_drag", "throttle_gain"],
        stretches=12,
        workers=1,
    )
    return replace(asked, **more)


@pytest.fixture(scope="module", params=[LEAST, pytest.param(FULL, marks=pytest.mark.slow)])
def minutes(request):
    return request.param


@pytest.fixture(scope="module")
def inside(recordings, minutes):
    return run_diagnosis(config(minutes=minutes), recordings)


@pytest.fixture(scope="module")
def around(recordings, minutes):
    return run_diagnosis(config(minutes=minutes, parameters=False), recordings)


def test_a_wrong_parameter_has_the_name_and_the_number_of_the_effect(inside, around):
    for done in (inside, around):
        [drag] = done.answer.effects
        assert drag.name == "viscous_drag"
        assert drag.confidence > 0.9
        assert drag.parameters["rate"].value == pytest.approx(RATE, rel=0.05)
        assert drag.parameters["rate"].unit == "1/s"


def test_it_is_said_how_it_is_realised(inside, around):
    own, wrapped = (done.answer.to_dict()["effects"][0] for done in (inside, around))
    assert own["realised"] == "parameter motor_damping"
    assert wrapped["realised"] == "effect"
    assert own["kind"] == wrapped["kind"] == "motion"
    assert "in the simulator: parameter motor_damping" in " ".join(inside.answer.lines())


def test_a_value_of_the_simulators_own_is_wrong_and_of_a_black_box_physics_is_missing(
    inside, around
):
    assert inside.answer.verdict == "wrong_parameters"
    assert around.answer.verdict == "missing_physics"


def test_the_repaired_simulator_has_it_as_a_parameter(inside, around, tmp_path):
    content = repaired_simulator(SIMULATOR, inside, tmp_path)
    assert "effects" not in content
    assert content["parameters"] == {
        "motor_damping": pytest.approx(DAMPING + RATE * MASS, rel=0.05)
    }
    file = tmp_path / "repaired.yaml"
    file.write_text(yaml.safe_dump(content))
    repaired_car = make_simulator(file, 1)
    assert float(repaired_car.numbers["motor_damping"]) > DAMPING
    assert "viscous_drag" in repaired_simulator(SIMULATOR, around, tmp_path)["effects"]


@pytest.mark.slow
def test_with_baseline_recordings_it_has_changed_and_is_inside_too(recordings, minutes):
    before = planted_drives([{}], seconds=12.0, seed=1, make=cars)[0]
    done = run_diagnosis(config(stretches=8, minutes=minutes), recordings, baseline=before)
    [drag] = done.answer.effects
    assert (drag.name, drag.inside) == ("viscous_drag", ("motor_damping",))
    assert done.answer.verdict == "missing_physics"  # the simulator was right
    assert not any(name.startswith("parameter:") for name in done.case.problem.library.names)
