"""Cases of cars with brakes and reverse, or with a speed controller."""

import json
import math

import pytest
import yaml

from buggy_rl.core.longitudinal import ONE_WAY
from buggy_rl.effects import OF_A_COMMAND, effect_class
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.draw import DrawConfig, draw, draw_all
from buggy_rl.proof.cases.sealing import CaseStore, seal
from buggy_rl.proof.cases.sizes import COMMANDED_SIZES
from buggy_rl.proof.plants import PLANTS, abilities
from buggy_rl.recordings import load_recordings

ABLE = {plant: abilities(plant) for plant in PLANTS}
BRAKED = DrawConfig(cases=0, each=True, pairings=["reference_brakes"], nothing=2)


def test_every_effect_of_a_command_has_a_range_of_its_own():
    assert set(COMMANDED_SIZES) == set(OF_A_COMMAND)
    for effect, sizes in COMMANDED_SIZES.items():
        known = {p.name: p for p in effect_class(effect).declared}
        for name, size in sizes.items():
            assert known[name].lower <= size.low < size.high <= known[name].upper
            assert not size.low <= known[name].value <= size.high


def test_only_cars_with_such_a_command_have_them():
    drawn = draw_all(BRAKED, ABLE)
    concealed = {effect for case in drawn for effect in case.concealed}
    own = {e for e, (_, kind, _) in OF_A_COMMAND.items() if kind == "throttle_brake_reverse"}
    assert concealed & set(OF_A_COMMAND) == own
    assert {case.command for case in drawn} == {"brakes"}
    one_way = [draw(seed, DrawConfig(families=["one", "two"]), ABLE) for seed in range(200)]
    assert not any(set(case.concealed) & set(OF_A_COMMAND) for case in one_way)
    assert {case.longitudinal for case in one_way} == {ONE_WAY}


def test_a_drag_brake_is_known_of_a_car_that_has_one_and_unknown_of_another():
    numbers = {"drag_brake": {"deceleration": 0.8}}
    assert Case(1, "reference", "reference", concealed=numbers, command="brakes").family == "one"
    share = {"drag_brake": {"share": 0.3}}
    assert Case(1, "reference", "reference", concealed=share).family == "unknown"


def test_an_unknown_command_is_refused():
    with pytest.raises(ValueError, match="no command 'clutch'; available: brakes, speed, throttle"):
        Case(1, "reference", "reference", command="clutch")


@pytest.mark.slow
@pytest.mark.parametrize("command", ["brakes", "speed"])
def test_a_case_is_sealed_with_all_that_is_needed_to_read_it(command, tmp_path):
    effect = {"brakes": "brake_gain", "speed": "speed_controller_lag"}[command]
    values = {"brakes": {"gain": 0.7}, "speed": {"time_constant": 0.1}}[command]
    case = Case(
        7, "reference", "reference", concealed={effect: values}, command=command, seconds=2.0
    )
    store = CaseStore(tmp_path / "shown", tmp_path / "sealed")
    assert seal(store, [case], []) == 1
    folder = store.inputs(case.id)
    question = yaml.safe_load((folder / "question.yaml").read_text())
    assert effect in question["effects"]
    options = yaml.safe_load((folder / "simulator.yaml").read_text())["options"]
    assert options["command"] == case.longitudinal.plain
    recordings, refused = load_recordings(str(folder / "recordings"), folder / question["columns"])
    assert not refused
    assert {r.command for r in recordings} == {case.longitudinal}
    assert math.isclose(sum(r.duration for r in recordings), 4.0, abs_tol=0.5)
    sealed = json.loads(store.truth(case.id).read_text())["case"]
    assert Case(**sealed) == case
