"""The rally car as an engine: its state rides along, and its faults are those of the textbook."""

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import check_env_specs

from buggy_rl.core import keys
from buggy_rl.proof.plants import abilities, make_plant
from buggy_rl.proof.plants.rally.car import RallyCar
from buggy_rl.proof.plants.rally.changes import floor_grip
from buggy_rl.proof.plants.rally.declared import PARAMETERS, as_author, drawn_parameters
from buggy_rl.proof.plants.rally.kinds import LIKE_THE_LIBRARY, UNKNOWN
from buggy_rl.proof.plants.rally.parameters import draw_parameters
from buggy_rl.proof.plants.rally.plant import SENSOR_KINDS, STATE
from buggy_rl.proof.plants.rally.textbook import EFFECTS, turning_mass
from buggy_rl.proof.plants.rally.unknowns import UNKNOWNS
from tests.proof.plants.drives import drive, follow, gained, start
from tests.proof.plants.rally.drives import weave

COAST, STRAIGHT = -1.0, 0.0
FAST = (2.0, 0.0, 0.0)
OWN = drawn_parameters(3)
SOUND = make_plant("rally", 1, {}, OWN)
LOCK = OWN["lock"]
TURN = ((80, -0.4, 0.4),)


def faulty(effect, **parameters):
    return make_plant("rally", 1, {effect: parameters}, OWN)


def inside(car, *actions, velocity=FAST):
    """The author's state after actions."""
    return car._unpacked(follow(car, start(car, velocity), actions)[1])


def more(effect, speed=2.0, **parameters):
    """Acceleration [m/s^2] of a coasting car that a fault adds."""
    state = start(SOUND, (speed, 0.0, 0.0))
    own, theirs = (
        gained(car, state, 10, COAST, STRAIGHT) for car in (SOUND, faulty(effect, **parameters))
    )
    return theirs - own


@pytest.mark.parametrize(
    "faults",
    [{}, {"wet_spill": {"size": 0.5}, "wind": {"force_x": 0.2}}, {"glare_hold": {"size": 0.3}}],
)
def test_a_rally_car_keeps_the_contract_of_an_environment(faults):
    check_env_specs(make_plant("rally", 2, faults, OWN))


def test_the_engine_moves_as_the_authors_car():
    numbers = as_author({name: np.full(1, value) for name, value in OWN.items()})
    car, commands = RallyCar(numbers), weave(100)
    state = car.start(np.zeros(3), np.array(FAST))
    for command in commands:
        state = car.step(state, command)
    ours = drive(SOUND, *[(1, *command) for command in commands], velocity=FAST)
    # Parameters and motion are kept in single precision.
    assert np.abs(ours[-1].numpy() - car.velocity(state)[0]).max() < 1e-4


def test_wheels_go_along_with_an_edited_velocity_and_the_rotor_with_the_wheels():
    _, state = follow(SOUND, start(SOUND, FAST), [(30, 0.2, 0.2)])
    edited = state.clone()
    edited[keys.VELOCITY] = edited[keys.VELOCITY] + torch.tensor([[0.8, 0.0, 0.0]])
    before, after = SOUND._unpacked(state), SOUND._unpacked(edited)
    steered = np.cos(after["rack"])[:, None] * [1, 1, 0, 0] + [0, 0, 1, 1]  # of the front wheels
    faster = (after["wheel"] - before["wheel"]) * OWN["radius"]
    assert np.allclose(faster, 0.8 * steered, atol=5e-3)
    geared = after["rotor"] / (SOUND._car.constants["gear_share"] * after["wheel"]).sum(1)
    assert np.allclose(geared, 1.0)


def test_a_slope_accelerates_the_free_car_by_its_number():
    assert more("floor_slope", along_x=0.3) == pytest.approx(0.3, rel=0.03)
    assert more("floor_slope", along_x=-0.3) == pytest.approx(-0.3, rel=0.03)


def test_drags_slow_the_free_car_by_their_numbers():
    assert more("rolling_resistance", deceleration=0.4) == pytest.approx(-0.4, rel=0.03)
    # 0.1 v^2 at 2 m/s and at 3 m/s, a little less as it slows down.
    assert more("aerodynamic_drag", 2.0, coefficient=0.1) == pytest.approx(-0.4, rel=0.06)
    assert more("aerodynamic_drag", 3.0, coefficient=0.1) == pytest.approx(-0.9, rel=0.08)


def test_a_wind_pushes_a_slow_car_by_its_number_as_the_mean_of_front_and_side():
    # From behind it is 1 / 1.5 of the number at rest, and falls by 2 v / W.
    k = SOUND._car.constants
    moved = float((k["mass"] + turning_mass(k))[0])
    speed = (0.6 * moved / (0.9 * float(k["drag_area"][0]))) ** 0.5
    expected = 0.4 * ((1 - 0.3 / speed) ** 2 + (0.3 / speed) ** 2)
    assert more("wind", 0.3, force_x=0.6) == pytest.approx(expected, rel=0.06)


def test_a_gain_scales_the_steered_curvature_and_an_offset_is_a_command():
    slow = (1.0, 0.0, 0.0)
    own = drive(SOUND, *TURN, velocity=slow)[-1]
    less = drive(faulty("steering_gain", gain=0.7), *TURN, velocity=slow)[-1]
    assert (less[2] / less[0]) / (own[2] / own[0]) == pytest.approx(0.7, rel=0.06)
    trimmed = drive(faulty("steering_offset", offset=0.15), (60, 0.0, 0.1))[-1]
    # It is there before the first command is.
    assert torch.allclose(trimmed, drive(SOUND, (60, 0.0, 0.25))[-1], atol=1e-3)


@pytest.mark.parametrize("channel", ["throttle", "steering"])
def test_a_dead_time_shifts_its_command(channel):
    late = drive(faulty(f"{channel}_dead_time", dead_time=0.05), (40, 0.3, 0.6), (40, -0.2, -0.5))
    throttle, steering = [0.3] * 40 + [-0.2] * 40, [0.6] * 40 + [-0.5] * 40
    if channel == "throttle":
        throttle = [-1.0] * 5 + throttle[:-5]
    else:
        steering = [0.0] * 5 + steering[:-5]
    shifted = drive(SOUND, *((1, t, s) for t, s in zip(throttle, steering, strict=True)))
    assert torch.allclose(late, shifted, atol=1e-6)


def test_slack_and_rate_of_the_servo_are_in_command():
    car = faulty("steering_backlash", width=0.2)
    state = inside(car, (40, 0.0, 0.8), (40, 0.0, 0.0))
    play = float(state["rack"][0] - state["servo"][0])
    assert play == pytest.approx(0.5 * (0.2 * LOCK + OWN["slack"]), rel=1e-5)
    car = faulty("steering_rate_limit", rate=2.0)
    few, many = (inside(car, (count, 0.0, 1.0))["servo"][0] for count in (10, 20))
    assert many - few == pytest.approx(0.1 * 2.0 * LOCK, rel=0.02)


def test_grip_scales_the_largest_lateral_acceleration():
    most = []
    for car in (SOUND, faulty("tire_grip", grip=0.6)):
        moving = drive(car, (70, -0.2, 1.0), velocity=(3.5, 0.0, 0.0))
        most.append(float((moving[:, 0] * moving[:, 2]).max()))
    # Friction falls with sliding speed, and the bristles are as stiff as before: a little above.
    assert most[1] / most[0] == pytest.approx(0.63, rel=0.08)


def test_a_balance_keeps_the_product_and_a_patch_is_where_it_is():
    own, theirs = (c._car.constants["grip"][0] for c in (
        SOUND, faulty("grip_balance", front_to_rear=0.7)))  # fmt: skip
    assert (theirs[0] / theirs[2]) / (own[0] / own[2]) == pytest.approx(0.7)
    assert theirs[0] * theirs[2] == pytest.approx(own[0] * own[2])
    patched = faulty("grip_patch", x=2.0, y=0.0, radius=1.0, grip=0.4)
    here, there = (
        floor_grip(patched._car.constants, patched._unpacked(start(patched, pose=(x, 0.0, 0.0))))
        for x in (0.0, 2.0)
    )
    assert (here == 1.0).all()
    assert there == pytest.approx(np.full((1, 4), 0.4))


def test_softer_tyres_need_a_larger_slip_angle_for_the_same_bend():
    drift = []
    for car in (SOUND, faulty("cornering_stiffness", ratio=0.6)):
        vx, vy, r = drive(car, (100, -0.3, 0.25), velocity=FAST)[-1].tolist()
        rear = OWN["front_share"] * OWN["wheelbase"]
        drift.append((vy - rear * r) / vx / (vx * r))  # rad over m/s^2
    assert drift[1] / drift[0] == pytest.approx(1 / 0.6, rel=0.15)


def test_a_payload_is_moved_by_the_same_motor():
    state = start(SOUND, (1.0, 0.0, 0.0))
    own, theirs = (
        gained(car, state, 10, -0.4) for car in (SOUND, faulty("payload", mass_ratio=1.4))
    )
    k = SOUND._car.constants
    moved = (k["mass"] + turning_mass(k)) / (1.4 * k["mass"] + turning_mass(k))
    rolling = 9.81 * OWN["rolling"]
    assert (theirs + rolling) / (own + rolling) == pytest.approx(float(moved[0]), rel=0.06)


def test_a_sensor_that_is_misled_leaves_the_motion_true():
    plain = follow(SOUND, start(SOUND, FAST), [(40, 0.4, 0.5)])[1]
    for kind in sorted(SENSOR_KINDS):
        car = faulty(kind, size=UNKNOWNS[kind][1])
        state = follow(car, start(car, FAST), [(40, 0.4, 0.5)])[1]
        assert torch.equal(state[keys.POSE], plain[keys.POSE])
        assert torch.equal(state[keys.VELOCITY], plain[keys.VELOCITY])
        shown = torch.cat([state[keys.MEASURED_POSE], state[keys.MEASURED_VELOCITY]], -1)
        true = torch.cat([state[keys.POSE], state[keys.VELOCITY]], -1)
        assert not torch.allclose(shown, true, atol=1e-4), kind
    assert keys.MEASURED_POSE not in plain


def test_enough_unknown_effects_have_no_name_and_those_that_have_are_listed():
    assert set(UNKNOWN) | set(LIKE_THE_LIBRARY) == set(UNKNOWNS)
    assert len(UNKNOWN) >= 12
    assert abilities("rally") == EFFECTS | set(UNKNOWNS)


@pytest.mark.parametrize(
    ("fault", "error", "words"),
    [
        ({"throttle_gain": {"gain": 0.8}}, KeyError, "rally plant has no effect throttle_gain"),
        ({"wet_spill": {"depth": 1.0}}, KeyError, "parameter size alone, not"),
        ({"wet_spill": {"size": 2.0}}, ValueError, r"wet_spill.size is 2: must be in \[0, 0.7\]"),
    ],
)
def test_what_a_rally_car_cannot_have_is_refused(fault, error, words):
    with pytest.raises(error, match=words):
        make_plant("rally", 1, fault)


def test_another_control_period_is_refused():
    with pytest.raises(ValueError, match=r"dt is 0.02 s: .* 0.01 s"):
        type(SOUND)(1, dt=0.02)


def test_a_car_is_the_authors_draw_within_what_is_declared():
    author = draw_parameters(np.random.default_rng(11), 1)
    assert drawn_parameters(11) == drawn_parameters(11) != drawn_parameters(12)
    assert drawn_parameters(11)["grip"] == float(author["grip"][0])
    assert drawn_parameters(11)["hidden_3"] == float(author["hidden"][0, 3])
    for p in PARAMETERS:
        assert p.lower <= drawn_parameters(11)[p.name] <= p.upper


def test_cars_of_a_batch_may_differ_and_faults_stay():
    car = make_plant("rally", 1, {"rolling_resistance": {"deceleration": 0.5}}, OWN)
    other = drawn_parameters(4)
    both = {n: torch.tensor([v, other[n]]) for n, v in OWN.items()}
    pair, state = car.with_parameters(TensorDict(both, [2])), None
    alone, _ = follow(car, start(car), [(40, 0.5, 0.3)])
    state = pair.reset()
    for _ in range(40):
        state.set(keys.ACTION, torch.tensor([[0.5, 0.3]]).expand(2, 2))
        state = pair.step(state)["next"]
    assert torch.allclose(state[keys.VELOCITY][0].double(), alone[-1], atol=1e-5)
    assert (state[keys.VELOCITY][1] - state[keys.VELOCITY][0]).abs().max() > 0.01
    assert state[STATE].dtype == torch.float64
