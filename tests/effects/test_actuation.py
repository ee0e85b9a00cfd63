import math

import pytest
import torch

from buggy_rl.core import keys
from buggy_rl.core.longitudinal import ONE_WAY, LongitudinalCommand
from buggy_rl.effects import (
    OF_A_DRIVE,
    STACK,
    effect_class,
    make_effect,
    make_effects,
    offered,
)
from buggy_rl.simulators.base import HoldEngine
from tests.effects.faults import commanded, follow, over, start

THROTTLE, STEERING = 0, 1


def reached(name, values, asked, velocity=(0.0, 0.0, 0.0), channel=STEERING, **state):
    """Commands that reach the engine when others [T] are given on one channel."""
    env = over([make_effect(name, values)])
    rest = torch.full_like(asked, -1.0 if channel == STEERING else 0.0)
    pair = (rest, asked) if channel == STEERING else (asked, rest)
    given = commanded(env, start(env, velocity, **state), torch.stack(pair, -1))
    assert torch.equal(given[:, 1 - channel], rest)  # the other channel is left alone
    return given[:, channel]


RAMP = torch.linspace(0.0, 0.5, 51)  # 0.01 more each period of 10 ms


@pytest.mark.parametrize("channel", ["throttle", "steering"])
def test_a_dead_time_of_25_ms_shifts_a_ramp_by_two_and_a_half_samples(channel):
    index = ("throttle", "steering").index(channel)
    got = reached(f"{channel}_dead_time", {"dead_time": 0.025}, RAMP, (1.0, 0, 0), index)
    torch.testing.assert_close(got[3:], RAMP[3:] - 0.025)


def test_a_dead_time_of_whole_periods_gives_the_very_commands_of_before():
    asked = torch.rand(40, generator=torch.Generator().manual_seed(0))
    got = reached("steering_dead_time", {"dead_time": 0.3}, asked)
    torch.testing.assert_close(got[30:], asked[:10], atol=1e-6, rtol=0)
    assert (got[:30].abs() < 1e-6).all()  # a standing car had straight wheels


def test_a_car_set_down_in_motion_was_told_before_what_it_is_told_first():
    asked = torch.full((5,), 0.4)
    for name, values in (
        ("steering_dead_time", {"dead_time": 0.05}),
        ("steering_lag", {"time_constant": 0.1}),
        ("steering_rate_limit", {"rate": 3.0}),
        ("steering_backlash", {"width": 0.2}),
    ):
        torch.testing.assert_close(reached(name, values, asked, (1.0, 0.0, 0.0)), asked)
        assert reached(name, values, asked)[0] < 0.35  # from a standstill it is late


@pytest.mark.parametrize("channel", ["throttle", "steering"])
def test_a_lag_has_gone_63_percent_of_the_way_after_its_time_constant(channel):
    # Means over periods of a step from rest: u (1 - exp(-t / T)) over 10 ms about its middle, so
    # the periods before and after t = T = 0.1 s average to 1 - 1/e up to second order.
    index = ("throttle", "steering").index(channel)
    rest = (-1.0, 0.0)[index]
    got = reached(f"{channel}_lag", {"time_constant": 0.1}, torch.full((20,), 0.6), channel=index)
    share = (got - rest) / (0.6 - rest)
    assert math.isclose(float(0.5 * (share[9] + share[10])), 1 - math.exp(-1), abs_tol=2e-3)
    # Exactly: the mean of the first period is 1 - (1 - e^-0.1) / 0.1.
    assert math.isclose(float(share[0]), 1 - (1 - math.exp(-0.1)) / 0.1, rel_tol=1e-5)


def test_a_ramp_through_a_lag_ends_up_its_time_constant_behind():
    # A staircase that rises by 0.01 each 10 ms is a ramp half a period ahead of its mean; behind
    # a lag of 50 ms it is five steps lower: 0.05.
    got = reached("steering_lag", {"time_constant": 0.05}, RAMP)
    torch.testing.assert_close(got[-1], RAMP[-1] - 0.05, atol=2e-5, rtol=0)


def test_a_rate_limit_goes_to_the_command_at_its_rate():
    # 5 a second is 0.05 a period: the mean of the first is 0.025, then 0.075, 0.125, ...; the
    # command of 0.12 is reached 4 ms into the third: 0.12 - 0.02 * 0.4 / 2 = 0.116.
    got = reached("steering_rate_limit", {"rate": 5.0}, torch.full((5,), 0.12))
    expected = torch.tensor([0.025, 0.075, 0.116, 0.12, 0.12])
    torch.testing.assert_close(got, expected, atol=1e-6, rtol=1e-5)


def test_a_slow_command_passes_a_rate_limit():
    got = reached("steering_rate_limit", {"rate": 20.0}, RAMP)
    # 0.01 a period at 20 a second takes 0.5 ms of 10 ms: its mean lags by 0.01 * 0.05 / 2.
    torch.testing.assert_close(got[1:], RAMP[1:] - 0.00025, atol=1e-6, rtol=0)


def test_backlash_follows_half_its_width_behind_on_either_side():
    time = torch.arange(200) * 0.01
    asked = 0.5 * torch.sin(2 * math.pi * time)
    got = reached("steering_backlash", {"width": 0.2}, asked)
    last = slice(100, None)  # the second turn of the loop
    up, down = asked[last].diff() > 0, asked[last].diff() < 0
    behind = (asked - got)[last]
    # Amplitude is less by half the width; on the loop's sides the linkage lags by that half.
    assert math.isclose(float(got[last].max()), 0.4, abs_tol=1e-3)
    middle = asked[last].abs() < 0.2
    torch.testing.assert_close(
        behind[1:][up & middle[1:]], torch.tensor(0.1).expand(int((up & middle[1:]).sum()))
    )
    torch.testing.assert_close(
        behind[1:][down & middle[1:]], torch.tensor(-0.1).expand(int((down & middle[1:]).sum()))
    )
    # Within the play the linkage rests: just after the turning point.
    turning = int(asked[last].argmax())
    assert torch.equal(got[last][turning], got[last][turning + 3])


def test_gains_and_offsets_stop_at_full_lock_and_full_drive():
    asked = torch.tensor([-1.0, -0.5, 0.0, 0.5, 1.0])
    gain = reached("steering_gain", {"gain": 1.5}, asked)
    torch.testing.assert_close(gain, torch.tensor([-1.0, -0.75, 0.0, 0.75, 1.0]))
    offset = reached("steering_offset", {"offset": 0.2}, asked)
    torch.testing.assert_close(offset, torch.tensor([-0.8, -0.3, 0.2, 0.7, 1.0]))
    # Drives 0, 0.25, 0.5, 0.75, 1 times 1.2, as throttle: 2 * 1.2 d - 1.
    drive = reached("throttle_gain", {"gain": 1.2}, asked, channel=THROTTLE)
    torch.testing.assert_close(drive, torch.tensor([-1.0, -0.4, 0.2, 0.8, 1.0]))
    trim = reached("throttle_offset", {"offset": -0.2}, asked, channel=THROTTLE)
    torch.testing.assert_close(trim, torch.tensor([-1.0, -0.7, -0.2, 0.3, 0.8]))


def test_a_deadband_takes_the_first_of_the_drive_and_the_same_from_the_rest():
    # Drives 0, 0.1, 0.5, 1 less 0.16: 0, 0, 0.34, 0.84.
    asked = torch.tensor([-1.0, -0.8, 0.0, 1.0])
    got = reached("throttle_deadband", {"width": 0.16}, asked, channel=THROTTLE)
    torch.testing.assert_close(got, torch.tensor([-1.0, -1.0, -0.32, 0.68]))


def test_a_speed_controller_may_give_back_what_its_deadband_takes():
    # Drives 0.1, 0.5, 1 less 0.16, times 1 / 0.84: 0, 0.34 / 0.84, 1.
    asked = torch.tensor([-0.8, 0.0, 1.0])
    whole = {"width": 0.16, "restored": 1.0}
    got = reached("throttle_deadband", whole, asked, channel=THROTTLE)
    torch.testing.assert_close(got, torch.tensor([-1.0, 2 * 0.34 / 0.84 - 1, 1.0]))


def test_a_weaker_motor_sets_off_at_the_same_throttle():
    # Onset 0.2: drives 0.1, 0.2, 0.6 become 0.1, 0.2, 0.2 + 0.5 * 0.4 = 0.4.
    asked = 2 * torch.tensor([0.1, 0.2, 0.6]) - 1
    values = {"gain": 0.5, "onset": 0.2}
    got = reached("throttle_gain", values, asked, channel=THROTTLE)
    torch.testing.assert_close(got, 2 * torch.tensor([0.1, 0.2, 0.4]) - 1)


def test_asymmetry_is_a_ratio_whose_product_is_one():
    asked = torch.tensor([0.4, -0.4])
    left, right = reached("steering_asymmetry", {"left_to_right": 1.44}, asked)
    assert math.isclose(float(left / -right), 1.44, rel_tol=1e-5)
    assert math.isclose(float(left * -right), 0.16, rel_tol=1e-5)
    assert left > 0.4


def test_a_battery_loses_its_share_by_its_own_clock():
    # After two minutes at 15 % a minute 70 % of the drive of 0.8 are left: throttle 2 * 0.56 - 1.
    asked = torch.full((1,), 0.6)
    loss = {"loss_per_minute": 0.15}
    got = reached("battery_sag", loss, asked, channel=THROTTLE, elapsed=(120.0,))
    torch.testing.assert_close(got, torch.tensor([0.12]))
    fresh = reached("battery_sag", loss, asked, channel=THROTTLE)
    torch.testing.assert_close(fresh, asked)


def test_the_clock_counts_on_is_edited_and_begins_anew():
    env = over([make_effect("battery_sag", {"loss_per_minute": 0.1})], batch_size=(2,))
    states = follow(env, start(env, elapsed=(5.0,)), torch.zeros(3, 2))
    torch.testing.assert_close(states[keys.ELAPSED][-1], torch.full((2, 1), 5.03))
    edited = states[-1].clone().set(keys.ELAPSED, torch.full((2, 1), 60.0))
    after = env.step(edited.set(keys.ACTION, torch.zeros(2, 2)))["next"]
    torch.testing.assert_close(after[keys.ELAPSED], torch.full((2, 1), 60.01))
    assert torch.equal(env.reset()[keys.ELAPSED], torch.zeros(2, 1))


def test_the_command_that_was_given_is_what_the_data_keep():
    env = over(make_effects({"steering_gain": {"gain": 0.5}, "throttle_offset": {"offset": 0.3}}))
    state = start(env).set(keys.ACTION, torch.tensor([0.1, 0.8]))
    assert torch.equal(env.step(state)[keys.ACTION], torch.tensor([0.1, 0.8]))


def test_radio_servo_and_linkage_act_in_that_order():
    # Late by two periods, then offset: an offset is not late.
    effects = {"steering_offset": {"offset": 0.1}, "steering_dead_time": {"dead_time": 0.02}}
    env = over(make_effects(effects))
    asked = torch.tensor([[0.0, 0.5]]).expand(4, 2)
    got = commanded(env, start(env), asked)[:, STEERING]
    torch.testing.assert_close(got, torch.tensor([0.1, 0.1, 0.6, 0.6]))


def test_beyond_full_command_goes_on_where_the_engine_does():
    # At full lock and full throttle, a gain of 1.2: a command of 1.2, a drive of 1.2.
    for name, action, channel, expected in (
        ("steering_gain", (0.5, 1.0), STEERING, 1.2),
        ("steering_gain", (0.5, -1.0), STEERING, -1.2),
        ("throttle_gain", (1.0, 0.2), THROTTLE, 1.4),
    ):
        engine = Listening()
        env = over([make_effect(name, {"gain": 1.2})], engine)
        env.step(start(env, (1.0, 0.0, 0.0)).set(keys.ACTION, torch.tensor(action)))
        got = engine.got[0]
        assert float(got[channel]) == pytest.approx(expected)
        assert float(got[1 - channel]) == pytest.approx(action[1 - channel])


class Listening(HoldEngine):
    """Holds its velocity, and keeps the commands that reach it."""

    reach = 2.0

    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        self.got = []

    def _advance(self, state, action):
        self.got.append(action)
        return super()._advance(state, action)


def test_what_goes_on_is_passed_through_what_stands_behind_it():
    # 1.2 of the gain, 1.1 more of it to the left; a stop at 90 % of the left ends both.
    effects = {"steering_gain": {"gain": 1.2}, "steering_asymmetry": {"left_to_right": 1.21}}
    for added, expected in (({}, 1.32), ({"steering_end_stop": {"left_cut": 0.1}}, 0.9)):
        engine = Listening()
        env = over(make_effects(effects | added), engine)
        env.step(start(env).set(keys.ACTION, torch.tensor([0.0, 1.0])))
        assert float(engine.got[0][STEERING]) == pytest.approx(expected)


LAGGING = 1 - math.exp(-0.01 / 0.05)  # share of its error that a servo of 50 ms corrects


@pytest.mark.parametrize(
    ("name", "values", "linked"),
    [
        (
            "steering_end_stop",
            {"left_cut": 0.4, "right_cut": 0.2},
            lambda s: min(max(s, -0.8), 0.6),
        ),
        ("steering_curve", {"curvature": 0.4}, lambda s: 0.6 * s + 0.4 * s**3),
        ("steering_asymmetry", {"left_to_right": 1.44}, lambda s: 1.2 * s if s > 0 else s / 1.2),
    ],
)
def test_a_map_of_the_linkage_is_of_where_a_lagging_servo_is(name, values, linked):
    engine = Listening()
    env = over([make_effect(name, values, lag=0.05)], engine)
    asked = [0.9] * 15 + [-0.9] * 25 + [0.2] * 10
    follow(env, start(env), torch.tensor([[0.0, steering] for steering in asked]))
    servo = wheels = 0.0
    for steering, got in zip(asked, engine.got, strict=True):
        servo += LAGGING * (steering - servo)
        wheels += LAGGING * (float(got[STEERING]) - wheels)
        assert wheels == pytest.approx(linked(servo), abs=1e-5)
    assert abs(linked(0.8) - 0.8) > 0.05  # a control: none of them is no map


def test_tyres_push_the_wheels_of_a_lagging_servo_through_the_play_at_once():
    engine = Listening()
    env = over([make_effect("steering_play", {"width": 0.1}, lag=0.05)], engine)
    state, servo = start(env, (2.0, 0.0, 0.0)), 0.0
    for rate, pushed in ((0.0, 0.0), (2.0, -0.05), (2.0, -0.05), (-2.0, 0.05)):
        moving = torch.tensor([2.0, 0.0, rate])
        state = state.set(keys.VELOCITY, moving).set(keys.ACTION, torch.zeros(2))
        state = env.step(state)["next"].clone()
        servo += LAGGING * (float(engine.got[-1][STEERING]) - servo)
        assert servo == pytest.approx(pushed, abs=1e-4)  # tanh(8) of it


def test_a_trim_ends_where_the_servo_does():
    engine = Listening()
    env = over([make_effect("steering_offset", {"offset": 0.3})], engine)
    env.step(start(env).set(keys.ACTION, torch.tensor([0.0, 0.9])))
    assert float(engine.got[0][STEERING]) == 1.0


@pytest.mark.parametrize("name", ["single_track", "kinematic", "reference", "mujoco"])
def test_a_longer_horn_turns_the_car_more_at_full_lock(name):
    rates = []
    for gain in (1.0, 1.2):
        env = over([make_effect("steering_gain", {"gain": gain})], name)
        states = follow(env, start(env, (1.0, 0.0, 0.0)), torch.tensor([[-0.4, 1.0]]).repeat(60, 1))
        rates.append(float(states[keys.VELOCITY][-1, 2] / states[keys.VELOCITY][-1, 0]))
    assert 1.08 < rates[1] / rates[0] < 1.3


@pytest.mark.parametrize("name", ["single_track", "reference", "mujoco"])
def test_a_fuller_battery_pulls_more_at_full_throttle(name):
    speeds = []  # from 4 m/s on, where the rear tyres hold what the motor gives
    for gain in (1.0, 1.2):
        env = over([make_effect("throttle_gain", {"gain": gain})], name)
        states = follow(env, start(env, (4.0, 0.0, 0.0)), torch.tensor([[1.0, 0.0]]).repeat(40, 1))
        speeds.append(float(states[keys.VELOCITY][-1, 0]))
    assert speeds[1] > speeds[0] + 0.05


def test_a_curved_steering_map_reaches_the_same_lock():
    asked = torch.tensor([-1.0, -0.5, 0.0, 0.5, 1.0])
    got = reached("steering_curve", {"curvature": 0.4}, asked)
    # 0.6 s + 0.4 s^3 at 0.5: 0.3 + 0.05.
    torch.testing.assert_close(got, torch.tensor([-1.0, -0.35, 0.0, 0.35, 1.0]))


def test_a_stop_on_one_side_ends_that_side_alone():
    asked = torch.tensor([-1.0, -0.5, 0.5, 1.0])
    got = reached("steering_end_stop", {"left_cut": 0.3}, asked)
    torch.testing.assert_close(got, torch.tensor([-1.0, -0.5, 0.5, 0.7]))


def test_a_dead_centre_is_missing_from_larger_commands_too():
    asked = torch.tensor([-0.5, -0.05, 0.05, 0.1, 0.5])
    got = reached("steering_dead_zone", {"width": 0.1}, asked)
    torch.testing.assert_close(got, torch.tensor([-0.4, 0.0, 0.0, 0.0, 0.4]))


def test_a_sticking_servo_rests_and_then_goes_all_the_way():
    asked = torch.tensor([0.15, 0.15, 0.3, 0.3, 0.4, 0.3])
    got = reached("servo_stiction", {"width": 0.2}, asked)
    # 0.3 is off by 1.5 widths: it goes there, and rests although 0.4 and then 0.3 are asked for.
    torch.testing.assert_close(got, torch.tensor([0.0, 0.0, 0.3, 0.3, 0.3, 0.3]))


def test_play_under_load_is_missing_from_the_inside_of_a_bend():
    asked = torch.full((1,), 0.5)
    straight = reached("steering_play", {"width": 0.2}, asked, (2.0, 0.0, 0.0))
    left = reached("steering_play", {"width": 0.2}, asked, (2.0, 0.0, 2.0))
    right = reached("steering_play", {"width": 0.2}, asked, (2.0, 0.0, -2.0))
    # tanh(4 / 0.5) = 1: half of the width.
    torch.testing.assert_close(
        torch.cat([straight, left, right]), torch.tensor([0.5, 0.4, 0.6]), atol=1e-5, rtol=0
    )


def shared_supply(steering, **values):
    """Drives that reach the engine at drive 0.8 with steering commands [T]."""
    env = over([make_effect("brown_out", values)])
    pair = torch.stack([torch.full_like(steering, 0.6), steering], -1)
    return 0.5 * (commanded(env, start(env), pair)[:, THROTTLE] + 1)


def test_a_moving_servo_takes_from_the_drive_until_it_is_there():
    got = shared_supply(torch.full((60,), 1.0), moving=0.5)
    # Behind its lag of 60 ms the servo moves at over 5 a second for 73 ms: half of the drive.
    torch.testing.assert_close(got[:6], torch.full((6,), 0.4))
    assert got[59] == pytest.approx(0.8, abs=1e-3)
    straight = shared_supply(torch.zeros(10), moving=0.5, holding=0.5)
    torch.testing.assert_close(straight, torch.full((10,), 0.8))


def test_a_servo_that_holds_takes_from_the_drive_all_the_time():
    got = shared_supply(torch.full((60,), -0.5), holding=0.2)
    assert got[59] == pytest.approx(0.8 * 0.9, abs=1e-3)


def test_heat_takes_from_the_drive_and_is_that_of_the_past():
    values = {"foldback": 0.5, "time_constant": 5.0}
    got = reached("thermal_foldback", values, torch.full((500,), 0.6), channel=THROTTLE)
    drive = 0.5 * (got + 1)
    # After 5 s at drive 0.8 h = 0.64 (1 - 1/e).
    assert float(drive[0]) == pytest.approx(0.8)
    heat = 0.64 * (1 - math.exp(-4.99 / 5))
    assert float(drive[-1]) == pytest.approx(0.8 * (1 - 0.5 * heat), rel=1e-4)
    effect = make_effect("thermal_foldback", values)
    # 0.64 for the last 3 s, 0.1 for the 3 before.
    memory = effect.warmed(torch.zeros(2, 1), torch.tensor([[0.64, 0.1]] * 2), (0.0, 3.0, 6.0))
    expected = 0.64 * (1 - math.exp(-0.6)) + 0.1 * (math.exp(-0.6) - math.exp(-1.2))
    torch.testing.assert_close(memory, torch.full((2, 1), expected))


SPEEDS = {"rest": 0.0, "full_speed": 5.0}


def setpoints(name, values, asked, velocity=(0.0, 0.0, 0.0)):
    """Setpoints [m/s] that reach the engine when others [T] [m/s] are given."""
    given = torch.stack([asked / 5.0, torch.zeros_like(asked)], -1)
    env = over([make_effect(name, values | SPEEDS)])
    return 5.0 * commanded(env, start(env, velocity), given)[:, THROTTLE]


def test_a_setpoint_follows_its_ramp_up_and_down():
    asked = torch.cat([torch.full((5,), 0.12), torch.full((4,), -1.0)])
    got = setpoints("speed_ramp", {"acceleration": 4.0}, asked)
    # 0.04 m/s a period, of which the engine gets the mean: 0.02, 0.06, 0.1, then 0.12; back down.
    expected = torch.tensor([0.02, 0.06, 0.10, 0.12, 0.12, 0.10, 0.06, 0.02, -0.02])
    torch.testing.assert_close(got, expected, atol=1e-5, rtol=0)


def test_below_the_least_speed_the_setpoint_is_the_cars_own_speed():
    asked = torch.tensor([0.2, 0.5, 0.7, -0.2])
    got = setpoints("least_speed", {"speed": 0.6}, asked, (1.5, 0.0, 0.0))
    torch.testing.assert_close(got, torch.tensor([1.5, 1.5, 0.7, 1.5]))


def test_the_integral_adds_what_is_missing_over_time_up_to_its_limit():
    asked = torch.full((300,), 1.0)  # and the car stands
    got = setpoints("speed_integral", {"rate": 0.5, "speed_gain": 10.0}, asked)
    # 0.5 of 1 m/s each second; the mean of a period is that of its middle; 3 / 10 m/s at most.
    torch.testing.assert_close(got[20], torch.tensor(1.0 + 0.5 * 0.205))
    torch.testing.assert_close(got[-1], torch.tensor(1.3))


def test_words_are_those_of_the_command():
    speed, current = LongitudinalCommand("speed"), LongitudinalCommand("current")
    gain = effect_class("throttle_gain")
    assert gain.sentence_for({"gain": 1.1}, speed) == "the car drives 10 % faster than commanded"
    assert "throttle" in gain.sentence_for({"gain": 1.1}, ONE_WAY)
    assert "current" in gain.sentence_for({"gain": 0.9}, current)
    offset = effect_class("throttle_offset")
    assert "5 % of its full speed above" in offset.sentence_for({"offset": 0.1}, speed)
    for name in STACK:
        values = {p.name: p.value + p.probe for p in effect_class(name).declared}
        assert effect_class(name).sentence_for(values, ONE_WAY) == effect_class(name).sentence(
            values
        )


def test_what_a_speed_controller_hides_is_not_offered_with_it():
    assert set(OF_A_DRIVE) <= set(offered(ONE_WAY))
    assert set(OF_A_DRIVE) <= set(offered(LongitudinalCommand("throttle_brake_reverse")))
    for kind in ("speed", "current"):
        assert not set(OF_A_DRIVE) & set(offered(LongitudinalCommand(kind)))
