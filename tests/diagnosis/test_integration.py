from functools import cache

from buggy_rl.diagnosis.integration import fine_enough
from buggy_rl.engines import make_engine
from buggy_rl.estimation.rollout import Player
from buggy_rl.estimation.segments import stretches
from tests.diagnosis.planted import planted_drives

COARSE = 0.005  # [s]; by itself MuJoCo's car steps in half of that


def mujoco(**given):
    """Builds players into MuJoCo's car, with further options than those it is given with."""

    @cache
    def make(cars, timestep=None):
        return make_engine("mujoco", cars, timestep=timestep)

    return lambda options: Player(lambda cars: make(cars, **{**given, **options}))


def looked_at(cut, **given):
    return fine_enough(mujoco(**given), cut)


def drives(**given):
    own = mujoco(**given)({}).make
    return stretches(planted_drives([{}], seconds=8.0, make=own)[0], 1.0, 1.0)


def test_a_step_too_coarse_is_halved_until_that_changes_nothing():
    cut = drives()
    for times in (1, 2):
        found = looked_at(cut, timestep=times * COARSE)
        assert found.options == {"timestep": COARSE / 2}
        assert "timestep=0.0025" in found.note


def test_a_step_that_is_fine_enough_stays():
    assert not looked_at(drives()).options


def test_a_simulator_that_is_right_with_its_coarse_step_keeps_it():
    # As one that was fitted with it is: what its equations say is not what was fitted.
    assert not looked_at(drives(timestep=COARSE), timestep=COARSE).options


def test_another_fault_of_the_car_is_not_taken_for_a_coarse_step():
    own = mujoco()({}).make
    heavy = planted_drives([{"parameter": {"mass": 3.3}}], seconds=8.0, make=own)[0]
    assert not looked_at(stretches(heavy, 1.0, 1.0)).options


def test_a_simulator_without_a_step_is_not_asked_for_another():
    def player(options):
        assert not options
        return Player(lambda cars: object())

    assert not fine_enough(player, drives()).options
