"""What faults of radio, steering and drive do to the motion: sign, size, and where nothing."""

import math

import pytest
import torch

from buggy_rl.core import keys
from buggy_rl.simulators.reference import ReferenceEngine
from buggy_rl.simulators.reference.parameters import DIMENSIONS
from buggy_rl.simulators.reference.state import DUTY, HEAT, RACK, SERVO
from buggy_rl.simulators.reference.steering import SecondOrderLag
from tests.simulators.reference_drives import held
from tests.simulators.reference_scenes import TURNING, Scenes, cars, crossing, velocities

SCENES = Scenes()


@pytest.fixture(scope="module")
def driven():
    return SCENES.driven()


# Commands.

SCENES.add(
    "late steering",
    "steering_dead_time.dead_time",
    (0.0, 0.06, 0.1234, 0.0005),
    (1.3, 0.0, 0.0),
    torch.cat([held(-0.4, 0.0, 1.2), held(-0.4, 0.5, 0.3)]),
)


@pytest.mark.slow
def test_late_steering_is_late_by_its_dead_time(driven):
    _, _, yaw_rate = velocities(driven("late steering"))
    plain, *late = crossing(yaw_rate, 0.3)
    for found, expected in zip(late, (0.06, 0.1234, 0.0005), strict=True):
        assert found - plain == pytest.approx(expected, abs=0.001)


SCENES.add(
    "late throttle",
    "throttle_dead_time.dead_time",
    (0.0, 0.0875),
    (0.0, 0.0, 0.0),
    held(0.0, 1.0, 0.5),
)


@pytest.mark.slow
def test_late_throttle_is_late_by_its_dead_time_and_leaves_the_steering_alone(driven):
    states = driven("late throttle")
    plain, late = crossing(velocities(states)[0], 0.5)
    assert late - plain == pytest.approx(0.0875, abs=0.001)
    assert torch.equal(states[SERVO][:, 0], states[SERVO][:, 1])


def commands(*pairs, seconds=0.4):
    """Commands [T, n, 2] of cars that each hold their own (throttle, steering)."""
    return torch.stack([held(*pair, seconds) for pair in pairs], 1)


REST = (0.0, 0.0, 0.0)
TRIM = commands((0.0, 0.35), (0.0, 0.2))
SCENES.add("steering trim", "steering_offset.offset", (0.0, 0.15), REST, TRIM)
SCENES.add("trim at the end", "steering_offset.offset", (0.0, 0.15), REST, held(0.0, 1.0, 0.4))
TRIM = commands((-0.15, 0.0), (0.0, 0.0))
SCENES.add("throttle trim", "throttle_offset.offset", (0.0, -0.15), REST, TRIM)


@pytest.mark.slow
@pytest.mark.parametrize("title", ["steering trim", "trim at the end", "throttle trim"])
def test_trim_is_the_same_as_another_command_up_to_the_end_of_the_channel(driven, title):
    pose = driven(title)[keys.POSE]
    assert pose[-1, 0, 0] > 0.1
    torch.testing.assert_close(pose[:, 1], pose[:, 0], atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize("time_constant", [0.02, 0.08, 0.3])
def test_a_follower_is_late_by_its_time_constant_and_does_not_overshoot(time_constant):
    law, state, late, last = (
        SecondOrderLag(torch.tensor([time_constant]), 1e-3),
        torch.zeros(2, 1),
        0,
        0,
    )
    for _ in range(2500):
        state = law.moved(state, torch.ones(1))
        assert last <= float(state[1]) <= 1.0
        last = float(state[1])
        late += 1e-3 * (1.0 - last)
    assert late == pytest.approx(time_constant, abs=0.001)


# Steering.

SCENES.add("slow servo", "steering_lag.time_constant", (0.0, 0.1), REST, held(-1, 0.5, 1.5))


def test_a_slow_servo_delays_the_turn_by_its_time_constant_on_average(driven):
    # At 0.5 of the lock the servo's own limit, 12 1/s, is not reached: 0.5 / 0.055 = 9 1/s.
    servo = driven("slow servo")[SERVO][..., 0]
    lateness = (0.01 * (0.5 - servo)).sum(0) / 0.5
    assert float(lateness[1] - lateness[0]) == pytest.approx(0.1, rel=0.02)


SCENES.add("slow motion", "steering_rate_limit.rate", (100.0, 3.0), REST, held(-1, 1, 0.2))
SCENES.add("small motion", "steering_rate_limit.rate", (100.0, 3.0), REST, held(-1, 0.1, 0.2))


def test_a_rate_limit_is_the_fastest_motion_of_the_servo_and_small_moves_do_not_feel_it(driven):
    servo = driven("slow motion")[SERVO][..., 0]
    assert float(servo[:, 1].diff().max()) == pytest.approx(0.03, rel=1e-3)
    servo = driven("small motion")[SERVO][..., 0]  # 0.1 / 0.055 = 1.8 1/s at most
    assert torch.equal(servo[:, 0], servo[:, 1])


def steered(engine, command):
    """Road-wheel angle [*] at a settled command."""
    return engine.car.steering.angle(torch.full(engine.batch_size, command))


def test_a_shorter_horn_turns_the_wheels_less_to_both_sides_and_leaves_the_trim():
    engine = cars("steering_gain.gain", 1.0, 0.8)
    for command in (1.0, 0.4, -0.7):
        plain, short = steered(engine, command).tolist()
        assert short == pytest.approx(0.8 * plain)
    bent = ReferenceEngine(faults={"steering_gain.gain": 0.8})
    assert float(steered(bent, 0.0)) == pytest.approx(0.008)


def test_asymmetry_is_left_over_right_at_every_angle_with_their_product_kept():
    engine = cars("steering_asymmetry.left_to_right", 1.0, 0.75)
    for command in (1.0, 0.3):
        left, right = steered(engine, command), -steered(engine, -command)
        assert float(left[1] / right[1]) == pytest.approx(0.75, rel=1e-5)
        assert float(left[1] * right[1]) == pytest.approx(float(left[0] * right[0]), rel=1e-5)
    again = engine.car.steering.servo_at(steered(engine, -0.6))
    torch.testing.assert_close(again, torch.full((2,), -0.6))


THERE = torch.linspace(0, 0.8, 80)
BACK_AND_FORTH = torch.stack([torch.full((160,), -1.0), torch.cat([THERE, THERE.flip(0)])], -1)
SCENES.add("play", "steering_backlash.width", (0.0, 0.2), REST, BACK_AND_FORTH)


def test_play_is_lost_at_every_reversal_and_nowhere_else(driven):
    states = driven("play")[1:, 1]
    servo, rack = states[SERVO][:, 0], states[RACK][:, 0]
    # Drawn along 0.1 behind going up, held over a reversal of 0.2, 0.1 ahead coming back.
    torch.testing.assert_close(rack[30:75], servo[30:75] - 0.1, atol=1e-5, rtol=0)
    torch.testing.assert_close(rack[-30:], servo[-30:] + 0.1, atol=1e-5, rtol=0)
    top = int(servo.argmax())
    still = (servo[top:] > servo.max() - 0.19).nonzero().flatten() + top
    assert (rack[still] - rack[top]).abs().max() < 1e-5
    assert len(still) > 10


SMALL_THEN_LARGE = torch.cat([held(-1, 0.15, 0.4), held(-1, 0.5, 0.6)])
SCENES.add("stick", "sticky_servo.breakaway", (0.0, 0.2), REST, SMALL_THEN_LARGE)


def test_a_sticky_servo_ignores_small_commands_and_obeys_large_ones(driven):
    servo = driven("stick")[SERVO][..., 0]
    assert servo[40, 0] == pytest.approx(0.15, abs=1e-3)
    assert servo[40, 1] == 0.0
    assert servo[-1, 0] == pytest.approx(0.5, abs=1e-3)
    # It stops a tenth of the breakaway short.
    assert servo[-1, 1] == pytest.approx(0.48, abs=0.005)


SCENES.add("bump at a crawl", "bump_steer.angle", (0.0, 0.01), (0.4, 0, 0.4), held(-0.55, 0.5, 1))
SCENES.add("bump at speed", "bump_steer.angle", (0.0, 0.01), (2.2, 0, 2.5), held(-0.1, 0.4, 0.6))


def test_bump_steer_turns_the_wheels_with_the_side_force_only(driven):
    crawl, quick = (velocities(driven(f"bump at {v}"))[2][-1] for v in ("a crawl", "speed"))
    assert crawl[0] > 0.1
    assert float(crawl[1] / crawl[0]) == pytest.approx(1.0, abs=0.03)
    assert quick[1] > 1.03 * quick[0]


SCENES.add("wobble", "wheel_wobble.angle", (0.0, 0.1), (2.0, 0.0, 0.0), held(-0.2, 0.0, 1.5))


def test_a_bent_wheel_shakes_the_car_once_a_turn(driven):
    vx, _, yaw_rate = (part[-128:] for part in velocities(driven("wobble")))
    assert yaw_rate[:, 0].abs().max() < 1e-3
    shaking = yaw_rate[:, 1] - yaw_rate[:, 1].mean()
    assert shaking.abs().max() > 0.1
    spectrum = torch.fft.rfft(shaking * torch.hann_window(128)).abs()
    turns = float(vx[:, 1].mean()) / (2 * math.pi * DIMENSIONS.wheel_radius)
    assert float(spectrum.argmax()) / 1.28 == pytest.approx(turns, abs=1.0)  # [Hz]


# Drive.

# So small that the controller's slew, 8 1/s, takes but 4 ms for it.
STEP = torch.cat([held(-0.3, 0.0, 0.6), held(-0.25, 0.0, 1.4)])
SCENES.add("filter", "throttle_lag.time_constant", (0.0, 0.12), REST, STEP)


def test_the_controllers_filter_delays_the_throttle_on_average_by_its_time_constant(driven):
    duty = driven("filter")[DUTY][60:, :, 0]
    late = (0.01 * (duty[:, 0] - duty[:, 1])).sum() / (duty[-1, 0] - duty[0, 0])
    assert float(late) == pytest.approx(0.12, rel=0.03)


def test_gain_and_deadband_are_those_of_the_duty_cycle():
    weak = cars("throttle_gain.gain", 1.0, 0.8, 1.3).car.drivetrain
    duty = weak.target_duty(torch.full((3,), 0.5))
    # drive 0.75 over a deadband of 0.16: 0.59 / 0.84
    assert duty.tolist() == pytest.approx([0.70238, 0.8 * 0.70238, 1.3 * 0.70238], rel=1e-4)
    assert weak.target_duty(torch.ones(3)).tolist() == pytest.approx([1.0, 0.8, 1.3])
    dead = cars("throttle_deadband.width", 0.0, 0.1).car.drivetrain
    # drive lost: 0.1, and of the rest 0.16; in throttle 2 (0.1 + 0.9 * 0.16) - 1 = -0.512
    edge, beyond, full = (dead.target_duty(torch.full((2,), u))[1] for u in (-0.512, -0.5, 1.0))
    assert float(edge) == pytest.approx(0, abs=1e-6)
    assert float(beyond) > 0.005
    assert float(full) == 1.0
    for part, size in ((weak, 3), (dead, 2)):
        again = part.target_duty(part.throttle_at(torch.full((size,), 0.4)))
        assert again.tolist() == pytest.approx([0.4] * size, abs=1e-6)


SCENES.add("worn", "battery_sag.loss_per_minute", (0.0, 0.6), REST, held(-0.1, 0.0, 2))


def test_a_worn_battery_is_weaker_the_longer_it_was_driven(driven):
    drivetrain = cars("battery_sag.loss_per_minute", 0.0, 0.3).car.drivetrain
    taken = (1.0 - 0.7) * 7920.0  # [A s] at the start
    fresh = drivetrain.open_voltage(torch.full((2,), taken))
    assert fresh[0] == fresh[1]
    # After a minute at 2.15 A: 0.3 of the voltage.
    minute = drivetrain.open_voltage(torch.full((2,), taken + 60 * 2.15))
    assert float(minute[1] / minute[0]) == pytest.approx(1 - 0.3, rel=1e-4)
    vx, _, _ = velocities(driven("worn"))
    assert vx[15, 1] > 0.99 * vx[15, 0]
    assert vx[-1, 1] < 0.985 * vx[-1, 0]


SCENES.add("limit", "motor_power_limit.power_per_mass", (1000.0, 5.0), REST, held(0.8, 0.0, 1.5))


def test_no_more_power_reaches_the_shaft_than_the_controller_allows(driven):
    drivetrain = cars("motor_power_limit.power_per_mass", 1000.0, 5.0).car.drivetrain
    speed = torch.full((2,), 3.0)
    current = drivetrain.current(torch.ones(2), speed, torch.full((2,), 7.9))
    power = drivetrain.motor_constant * speed * current / 1.625  # [W/kg]
    assert float(power[0]) > 15
    assert float(power[1]) == pytest.approx(5.0, rel=1e-4)
    vx, _, _ = velocities(driven("limit"))
    gain = (0.5 * TURNING * vx.square()).diff(dim=0) / 0.01  # [W/kg]
    assert gain[30:, 0].max() > 7
    assert gain[30:, 1].max() < 5.0
    plain, limited = crossing(vx, 0.3)
    assert limited - plain < 0.03  # off the line nothing is missing


SCENES.add("winding", "top_speed.speed_ratio", (1.0, 0.6), (3.5, 0.0, 0.0), held(0.0, 0.0, 2))


def test_another_winding_has_another_free_speed_and_the_same_force_at_rest(driven):
    engine = cars("top_speed.speed_ratio", 1.0, 0.6).car.drivetrain
    voltage, ones = torch.full((2,), 8.0), torch.ones(2)
    force = engine.motor_constant * engine.current(ones, torch.zeros(2), voltage)
    assert float(force[1] / force[0]) == pytest.approx(1.0, rel=0.06)  # but for the battery's own
    free = 8.0 / engine.motor_constant
    assert float(free[1] / free[0]) == pytest.approx(0.6)
    vx, _, _ = velocities(driven("winding"))
    assert vx[-1, 1] < 0.75 * vx[-1, 0]


COAST = held(-1.0, 0.0, 0.6)
SCENES.add("brake", "drag_brake.share", (0.0, 0.3), (2.6, 0.0, 0.0), COAST)
SCENES.add("no brake", "drag_brake.share", (0.0, 0.3), (1.0, 0.0, 0.0), held(0.5, 0.0, 0.4))


def test_a_drag_brake_slows_a_coasting_car_and_no_driven_one(driven):
    drivetrain = cars("drag_brake.share", 0.0, 0.3).car.drivetrain
    current = drivetrain.current(torch.zeros(2), torch.full((2,), 3.0), torch.full((2,), 8.0))
    # Back-EMF 0.0032 * 6.7 / 0.0325 = 0.6597 V s/m: 0.3 * -1.979 V / 0.42 ohm = -1.414 A.
    assert current.tolist() == pytest.approx([0, -1.414], rel=1e-3)
    coasting = velocities(driven("brake"))[0][-1]
    assert coasting[1] < coasting[0] - 0.1
    pulled = velocities(driven("no brake"))[0]
    assert torch.equal(pulled[:, 0], pulled[:, 1])


WORK = torch.cat([held(0.6, 0.0, 1.0), held(-1, 0.0, 1.0)])
SCENES.add("hot", "heating_motor.rise", (0.0, 0.02), REST, WORK)


def test_a_hot_motor_pulls_less_and_recovers(driven):
    states = driven("hot")
    vx, heat = velocities(states)[0], states[HEAT][..., 0]
    assert vx[10, 1] > 0.97 * vx[10, 0]
    assert vx[100, 1] < 0.95 * vx[100, 0]
    # A motor without current gives its heat to the can within 30 s: e^(-0.8 / 30).
    assert float(heat[-1, 0] / heat[-81, 0]) == pytest.approx(math.exp(-0.8 / 30), rel=1e-3)


KICKS = torch.cat([held(-0.4, 0.0, 0.5), held(0.1, 0.0, 1.0), held(-0.6, 0.0, 0.3)])
SCENES.add("loose", "loose_differential.time_constant", (0.0, 0.15), (1.0, 0.0, 0.0), KICKS)


def test_a_loose_differential_kicks_the_car_when_the_throttle_changes(driven):
    yaw_rate = velocities(driven("loose"))[2]
    assert yaw_rate[:, 0].abs().max() < 1e-4
    assert yaw_rate[50:80, 1].max() > 0.05  # the right wheel pulls first: to the left
    assert yaw_rate[140:150, 1].abs().max() < 0.04
    assert yaw_rate[150:, 1].min() < -0.05


SCENES.add("stiction", "servo_stiction.width", (0.0, 0.2), REST, SMALL_THEN_LARGE)


def test_stiction_is_a_sticky_servo_by_its_name_in_the_library(driven):
    named, unnamed = driven("stiction")[SERVO], driven("stick")[SERVO]
    assert torch.equal(named, unnamed)


def test_the_linkage_may_be_bent_stopped_or_loose():
    roll = torch.tensor([0.0, 0.0])
    bent = cars("steering_curve.curvature", 0.0, 0.4).car.steering
    # 0.6 x + 0.4 x^3 at 0.5
    assert bent.linked(torch.full((2,), 0.5), roll).tolist() == pytest.approx([0.5, 0.35])
    stopped = cars("steering_end_stop.left_cut", 0.0, 0.3).car.steering
    assert stopped.linked(torch.full((2,), 0.9), roll).tolist() == pytest.approx([0.9, 0.7])
    assert stopped.linked(torch.full((2,), -0.9), roll).tolist() == pytest.approx([-0.9, -0.9])
    loose = cars("steering_play.width", 0.0, 0.2).car.steering
    for side, expected in ((50.0, 0.4), (-50.0, 0.6)):
        held = loose.linked(torch.full((2,), 0.5), torch.full((2,), side))
        assert held.tolist() == pytest.approx([0.5, expected], abs=1e-4)
    dead = cars("steering_dead_zone.width", 0.0, 0.1).car.steering
    for given, expected in ((0.05, 0.0), (0.5, 0.4), (-0.5, -0.4)):
        held = dead.centred(torch.full((2,), given))
        assert held.tolist() == pytest.approx([given, expected], abs=1e-7)


def test_a_resistance_of_the_battery_takes_force_with_the_square_of_the_duty_cycle():
    drivetrain = cars("voltage_sag.resistance_ratio", 0.0, 0.5).car.drivetrain
    for duty in (1.0, 0.5):
        for speed in (0.0, 3.0):
            given = (torch.full((2,), duty), torch.full((2,), speed), torch.full((2,), 8.0))
            whole, less = drivetrain.current(*given).tolist()
            own = float(drivetrain.battery_resistance[0] / drivetrain.motor_resistance[0])
            expected = (1 + own * duty**2) / (1 + (own + 0.5) * duty**2)
            assert less / whole == pytest.approx(expected, rel=1e-5)


def test_a_shorter_gear_pulls_more_and_runs_out_of_speed_earlier():
    engine = cars("gear_ratio.ratio", 1.0, 1.25).car.drivetrain
    voltage, ones = torch.full((2,), 8.0), torch.ones(2)
    force = engine.motor_constant * engine.current(ones, torch.zeros(2), voltage)
    assert float(force[1] / force[0]) == pytest.approx(1.25)
    free = 8.0 / engine.motor_constant
    assert float(free[0] / free[1]) == pytest.approx(1.25)


SWING = torch.stack([torch.full((100,), 0.3), torch.sin(0.2 * torch.arange(100))], -1)
SCENES.add("shared supply", "brown_out.moving", (0.0, 0.8), (1.0, 0.0, 0.0), SWING)
SCENES.add("shared supply, straight", "brown_out.moving", (0.0, 0.8), (1.0, 0.0, 0.0), KICKS)


def test_the_drive_fails_while_the_servo_moves_and_not_else(driven):
    vx, _, _ = velocities(driven("shared supply"))
    assert vx[-1, 1] < 0.9 * vx[-1, 0]
    straight = velocities(driven("shared supply, straight"))[0]
    assert torch.equal(straight[:, 0], straight[:, 1])


LONG = held(0.8, 0.0, 3.0)
SCENES.add("limited", "thermal_foldback.foldback", (0.0, 0.9), REST, LONG)


def test_a_controller_that_gets_hot_gives_less_and_not_at_once(driven):
    vx, _, _ = velocities(driven("limited"))
    assert vx[20, 1] > 0.99 * vx[20, 0]
    assert vx[-1, 1] < 0.98 * vx[-1, 0]
