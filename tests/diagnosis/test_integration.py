from functools import cache

import pytest

from buggy_rl.diagnosis.config import DEFAULTS
from buggy_rl.diagnosis.run.maker import Maker, as_mujoco_steps, fine_enough, in_closed_form
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import cut_segments
from buggy_rl.simulators import make_engine
from tests.diagnosis.planted import planted_drives

COARSE = 0.005  # [s]; by itself MuJoCo's car steps in half of that


def mujoco(**given):
    """Builds simulations of MuJoCo's car, with further options than those it is given with."""

    @cache
    def make(cars, timestep=None):
        return make_engine("mujoco", cars, timestep=timestep)

    return lambda options: Simulation(lambda cars: make(cars, **{**given, **options}))


def step_for(segments, **given):
    return fine_enough(mujoco(**given), segments, DEFAULTS.finer_step_gain)


@cache
def drives(timestep=None, mass=None, seconds=4.0):
    own = mujoco(timestep=timestep)({}).make
    planted = {} if mass is None else {"parameter": {"mass": mass}}
    return cut_segments(planted_drives([planted], seconds=seconds, make=own)[0], 1.0, 1.0)


def test_a_step_too_coarse_is_halved_until_that_changes_nothing():
    segments = drives()
    for times in (1, 2):
        found = step_for(segments, timestep=times * COARSE)
        assert found.options == {"timestep": COARSE / 2}
        assert "timestep=0.0025" in found.note


def test_a_step_that_is_fine_enough_stays():
    assert not step_for(drives()).options


@pytest.mark.slow
def test_a_simulator_that_is_right_with_its_coarse_step_keeps_it():
    # As one that was fitted with that step is.
    assert not step_for(drives(timestep=COARSE, seconds=8.0), timestep=COARSE).options


@pytest.mark.slow
def test_another_fault_of_the_car_is_not_taken_for_a_coarse_step():
    assert not step_for(drives(mass=3.3)).options


def test_a_simulator_without_a_step_keeps_its_options():
    def simulation(options):
        assert not options
        return Simulation(lambda cars: object())

    assert not fine_enough(simulation, drives(), DEFAULTS.finer_step_gain).options


@pytest.mark.slow
def test_a_step_is_halved_at_most_three_times():
    recordings = planted_drives([{}], cars=1, seconds=1.0, make=mujoco()({}).make)[0]
    found = fine_enough(mujoco(timestep=COARSE), cut_segments(recordings, 0.2, 0.5), -100.0)
    assert found.options == {"timestep": COARSE / 8}


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("engine: mujoco\n", {"backend": "closed"}),
        ("engine: mujoco\noptions: {tyres: contact}\n", {}),
        ("engine: mujoco\noptions: {backend: cpu}\n", {}),
    ],
)
def test_mujocos_car_is_stepped_in_closed_form_unless_its_file_says_otherwise(
    tmp_path, text, found
):
    (tmp_path / "beneath.yaml").write_text(text)
    (tmp_path / "car.yaml").write_text("engine: beneath.yaml\n")
    assert in_closed_form(str(tmp_path / "car.yaml")) == found


def test_where_the_closed_form_is_not_mujocos_its_own_steps_are_taken(monkeypatch):
    closed, segments = Maker("mujoco", options={"backend": "closed"}), drives()
    make, [note] = as_mujoco_steps(closed, segments)
    assert make is closed
    assert "in closed form: nine in ten rollouts end within" in note
    monkeypatch.setattr("buggy_rl.diagnosis.run.maker.CLOSE", -1.0)
    make, [note] = as_mujoco_steps(closed, segments)
    assert make.options["backend"] == "cpu"
    assert note.startswith("MuJoCo's own steps are taken")
    assert as_mujoco_steps(make, segments) == (make, [])
