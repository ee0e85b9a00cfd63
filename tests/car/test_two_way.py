"""A car with brakes and reverse is stopped by throttle 0: -1 would drive it backwards."""

import sys

import pytest

from buggy_rl.car.clock import Clock
from buggy_rl.car.commands import COMMANDS, make_command_filter
from buggy_rl.car.drive import make_config
from buggy_rl.car.guard import Guard, GuardTimes
from buggy_rl.car.human import Controls, HumanConfig, HumanInput
from buggy_rl.car.interfaces import NEUTRAL, TWO_WAY_NEUTRAL
from buggy_rl.car.joystick import Joystick
from buggy_rl.car.path import Pursuit, PursuitConfig
from buggy_rl.car.pwm_pca9685 import Wiring, throttle_servo
from buggy_rl.car.ros import Ackermann, ackermann_of
from buggy_rl.car.safety import Safety
from buggy_rl.car.watchdog_link import Watchdog
from tests.car.fake_pygame import FakePygame
from tests.car.motion import Drive
from tests.car.test_guard import Board
from tests.car.test_human import driven
from tests.car.test_watchdog import Log, drive

CAR = {
    "sensor": {"kind": "t265"},
    "actuator": {"kind": "pca9685"},
    "pilot": {"kind": "joystick"},
    "policy": {"kind": "none"},
    "output": "drives",
    "geofence": "none",
}
OPEN = Safety(throttle_cap=0.5, throttle_floor=-0.4)


def armed(policy):
    made = Drive(OPEN, at_rest=TWO_WAY_NEUTRAL)
    made.policy = policy
    return made.arm()


def test_unarmed_and_disarmed_it_is_neutral_at_0():
    made = Drive(OPEN, at_rest=TWO_WAY_NEUTRAL).run(0.3)
    assert {d.command for d in made.decisions} == {TWO_WAY_NEUTRAL}
    made.arm().hold = False
    assert made.run(0.01).last.command == TWO_WAY_NEUTRAL


def test_without_readings_it_coasts_at_0_with_its_steering_kept():
    made = armed((-0.3, 0.3)).run(0.1, lambda stamp: [])
    assert made.last.source == "coast"
    assert made.last.command == (0.0, pytest.approx(0.3))


@pytest.mark.parametrize(("asked", "given"), [(0.9, 0.5), (-0.9, -0.4), (-0.2, -0.2), (0.0, 0.0)])
def test_cap_and_floor_bound_drive_and_reverse(asked, given):
    assert armed((asked, 0.0)).last.command[0] == pytest.approx(given)


def test_a_brake_is_let_go_at_once_and_drive_comes_no_faster_than_its_limit():
    limits = armed((-0.4, 0.0)).supervisor.limits
    assert limits.bounded((0.0, 0.0), 0.01) == (0.0, 0.0)
    assert limits.bounded((0.5, 0.0), 0.01)[0] == pytest.approx(20.0 * 0.01)
    assert limits.bounded((-0.4, 0.0), 0.01)[0] == pytest.approx(-0.4)


def test_a_person_who_brakes_cannot_arm_the_car():
    made = Drive(OPEN, at_rest=TWO_WAY_NEUTRAL)
    made.own = (-0.5, 0.0)
    made.run(0.3).hold = True
    assert not made.run(0.3).last.armed
    assert "not at rest" in made.message


def test_a_floor_above_the_cap_is_refused():
    with pytest.raises(ValueError, match=r"throttle_floor=0\.2: must be at most throttle_cap 0"):
        Safety.from_dict({"throttle_floor": 0.2})


def test_the_guard_writes_0_when_it_hears_nothing():
    board = Board()
    guard = Guard(board, GuardTimes(), 0.0, TWO_WAY_NEUTRAL)
    guard.act(0.0)
    guard.act(0.2)
    assert board.taken == [TWO_WAY_NEUTRAL, TWO_WAY_NEUTRAL]


def test_the_watchdog_s_process_begins_and_ends_with_0(tmp_path):
    log = Log(tmp_path)
    watchdog = Watchdog(log.about, Clock(), two_way=True)
    assert log.last() == TWO_WAY_NEUTRAL
    drive(watchdog, log, (-0.3, 0.1))
    log.wait_for(TWO_WAY_NEUTRAL)  # nothing is heard any more
    assert watchdog.close()
    assert {command[1] for command in log.commands()} == {0.0, -0.3}


@pytest.mark.parametrize("name", COMMANDS)
def test_filters_of_commands_begin_at_0(name):
    options = {"action_smoothing": {"share": 0.5}, "rate_limit": {"largest": (0.1, 0.1)}}
    made = make_command_filter({"name": name, **options.get(name, {})}, TWO_WAY_NEUTRAL)
    made.filtered((1.0, 1.0))
    made.reset()
    assert made.now == TWO_WAY_NEUTRAL


def test_pursuit_drives_on_a_straight_and_brakes_a_car_that_is_far_too_fast():
    one, two = Pursuit(PursuitConfig()), Pursuit(PursuitConfig(), two_way=True)
    # At 1.2 m/s wanted and driven: 0.22 + 0.1 x 1.2 = 0.34 of the drive.
    assert two._throttle(0.34, 1.2) == pytest.approx(0.34)
    assert one._throttle(0.34, 1.2) == pytest.approx(2 * 0.34 - 1)
    assert two._throttle(-0.2, 3.0) == pytest.approx(-0.2)
    assert two._throttle(-0.2, 0.2) == 0.0  # it would reverse
    assert one._throttle(-0.2, 3.0) == -1.0


def test_the_board_s_pulse_has_no_drive_in_its_middle_and_reverse_below():
    wiring = Wiring(two_way=True, throttle_limit=0.8)
    assert throttle_servo(0.0, wiring) == 0.5
    assert throttle_servo(0.4, wiring) == pytest.approx(0.7)
    assert throttle_servo(-0.4, wiring) == pytest.approx(0.3)
    assert throttle_servo(-1.0, wiring) == pytest.approx(0.2)  # the limit holds both ways
    assert throttle_servo(-1.0, Wiring()) == 0.5


def test_an_ackermann_car_is_reversed_by_a_speed_and_braked_by_an_acceleration():
    speed = Ackermann(two_way=True, throttle="speed", top_speed=3.0)
    assert ackermann_of(-0.5, 0.0, speed)[1:] == (-1.5, 0.0)
    assert ackermann_of(0.0, 0.0, speed)[1:] == (0.0, 0.0)
    braked = Ackermann(two_way=True, top_acceleration=4.0)
    assert ackermann_of(-0.5, 0.0, braked)[1:] == (0.0, 2.0)


def test_keys_drive_brake_and_fall_back_to_0():
    config = HumanConfig(two_way=True, top_throttle=0.5, throttle_rise=2.0, throttle_fall=4.0)
    assert driven(Controls(throttle=1.0), 60, config)[-1][0] == pytest.approx(0.5)
    braking = driven(Controls(reverse=True), 60, config)
    assert braking[0][0] == pytest.approx(-0.04)
    assert braking[-1][0] == pytest.approx(-0.5)
    assert HumanInput(config).command(0.01) == TWO_WAY_NEUTRAL
    assert driven(Controls(reverse=True), 9)[-1] == NEUTRAL  # of a car that cannot


def test_keys_need_a_top_throttle_above_no_drive():
    with pytest.raises(ValueError, match=r"top_throttle=0: must be in \(0, 1\], where two_way"):
        HumanInput(HumanConfig(two_way=True))


def test_the_right_trigger_drives_and_the_left_one_brakes(monkeypatch):
    fake = FakePygame()
    monkeypatch.setitem(sys.modules, "pygame", fake)
    pilot = Joystick.from_dict({"two_way": True})
    assert pilot.command(0.01) is None
    fake.move(5, 0.0)
    assert pilot.command(0.01) == (pytest.approx(0.5), 0.0)
    fake.move(5, -1.0)
    fake.move(2, 1.0)
    assert pilot.command(0.01) == (pytest.approx(-1.0), 0.0)
    fake.move(2, -1.0)
    assert pilot.command(0.01) is None


def test_one_word_of_the_config_reaches_every_driver_of_ours():
    config = make_config({**CAR, "two_way": True})
    assert config.at_rest == TWO_WAY_NEUTRAL
    assert config.told(config.actuator) == {"kind": "pca9685", "two_way": True}
    assert config.told(config.pilot) == {"kind": "joystick", "two_way": True}
    assert config.told({"kind": "mine:Actuator"}) == {"kind": "mine:Actuator"}
    plain = make_config(CAR)
    assert plain.at_rest == NEUTRAL
    assert plain.told(plain.actuator) == {"kind": "pca9685"}
