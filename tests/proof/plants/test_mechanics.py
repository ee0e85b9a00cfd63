"""Stages between command and wheels, each against what is worked out by hand."""

import numpy as np
import pytest

from buggy_rl.proof.plants.commonroad import command_weights
from buggy_rl.proof.plants.faults import EFFECTS, PlantFaults
from buggy_rl.proof.plants.mechanics import MINUTES, Mechanics

H = 0.0025  # [s]


def stages(typical=2.0, **faults):
    mechanics = Mechanics(PlantFaults(faults, EFFECTS, "test"), H, typical)
    return mechanics, mechanics.rest(1)


def steered(mechanics, memory, *commands):
    return np.array([mechanics.steering(memory, np.array([c]))[0] for c in commands])


def test_a_lag_is_at_63_percent_after_its_time_constant():
    mechanics, memory = stages(steering_lag={"time_constant": 0.1})
    rack = steered(mechanics, memory, *[1.0] * 40)
    # The last of 40 steps of 2.5 ms is the mean over 97.5 to 100 ms: 1 - exp(-0.98750).
    assert rack[-1] == pytest.approx(1 - np.exp(-0.9875), abs=1e-4)


def test_a_throttle_lag_starts_from_no_drive():
    mechanics, memory = stages(throttle_lag={"time_constant": 0.2})
    for _ in range(80):
        throttle = mechanics.throttle(memory, np.array([1.0]))
    # -1 + 2 (1 - exp(-t / T)) in the middle of the last step, t = 198.75 ms.
    assert throttle[0] == pytest.approx(1 - 2 * np.exp(-0.99375), abs=1e-4)


def test_a_rate_limit_ramps():
    mechanics, memory = stages(steering_rate_limit={"rate": 4.0})
    rack = steered(mechanics, memory, *[1.0] * 110)
    # 0.01 a step; each gives its mean; the lock is reached after 100 steps, 0.25 s.
    assert rack[0] == pytest.approx(0.005)
    assert rack[49] == pytest.approx(0.495)
    assert rack[-1] == pytest.approx(1.0)


def test_play_is_passed_before_the_rack_moves():
    mechanics, memory = stages(steering_backlash={"width": 0.2})
    rack = steered(mechanics, memory, 0.05, 0.5, 0.35, 0.3, 0.2, -0.4)
    # Half the play is 0.1 from the middle; turning back passes all of it, 0.5 to 0.3.
    assert rack == pytest.approx([0.0, 0.4, 0.4, 0.4, 0.3, -0.3])


def test_asymmetry_is_shared_by_both_sides_and_gain_multiplies():
    mechanics, memory = stages(
        steering_asymmetry={"left_to_right": 0.64}, steering_gain={"gain": 0.5}
    )
    # sqrt(0.64) = 0.8: left 0.5 x 0.8 x 0.5, right -0.5 / 0.8 x 0.5.
    assert steered(mechanics, memory, 0.5, -0.5) == pytest.approx([0.2, -0.3125])


def test_a_deadband_takes_its_width_of_drive():
    mechanics, memory = stages(throttle_deadband={"width": 0.1})
    # Drive 0.6 is throttle 0.2; less 0.1 it is 0.5, throttle 0.
    assert mechanics.throttle(memory, np.array([0.2]))[0] == pytest.approx(0.0)


def test_a_stronger_battery_is_stronger_at_full_throttle_too():
    mechanics, memory = stages(throttle_gain={"gain": 1.5})
    duty = mechanics.duty(memory, np.array([0.4, 0.9]))
    assert duty == pytest.approx([0.6, 1.35])


def test_a_sticking_servo_moves_when_it_is_off_by_more_than_its_width_and_then_all_the_way():
    mechanics, memory = stages(servo_stiction={"width": 0.2})
    rack = steered(mechanics, memory, 0.1, 0.19, 0.25, 0.3, 0.1, 0.05)
    # At 0.25 it moves; 0.3 is off by 0.05, over the tenth at which it rests: it goes on, and so it
    # does to 0.1 and 0.05.
    assert rack == pytest.approx([0.0, 0.0, 0.25, 0.3, 0.1, 0.05])
    assert steered(mechanics, memory, 0.05, 0.2)[-1] == pytest.approx(0.05)  # it had come to rest


def test_the_steering_map_is_dead_in_the_middle_bent_and_stopped():
    mechanics, memory = stages(steering_dead_zone={"width": 0.1})
    assert steered(mechanics, memory, 0.05, 0.5, -0.5) == pytest.approx([0.0, 0.4, -0.4])
    mechanics, memory = stages(steering_curve={"curvature": 0.4})
    # 0.6 x + 0.4 x^3 at 0.5: 0.3 + 0.05.
    assert steered(mechanics, memory, 0.5, -1.0) == pytest.approx([0.35, -1.0])
    mechanics, memory = stages(steering_end_stop={"left_cut": 0.3, "right_cut": 0.1})
    assert steered(mechanics, memory, 1.0, -1.0, 0.5) == pytest.approx([0.7, -0.9, 0.5])


def test_tyres_push_the_wheels_out_of_the_bend_by_half_of_the_play():
    mechanics, memory = stages(steering_play={"width": 0.2})
    for lateral, expected in ((1e6, 0.4), (-1e6, 0.6), (0.6, 0.45)):
        rack = mechanics.steering(memory, np.array([0.5]), np.array([lateral]))
        assert rack == pytest.approx([expected], abs=1e-5)


def test_a_resistance_takes_with_the_square_of_the_duty_cycle():
    mechanics, memory = stages(voltage_sag={"resistance_ratio": 0.5})
    duty = mechanics.duty(memory, np.array([1.0, 0.5]))
    assert duty == pytest.approx([1 / 1.5, 0.5 / 1.125])


def test_what_is_asked_for_heats_and_heat_takes_from_the_duty_cycle():
    faults = {"thermal_foldback": {"foldback": 0.5, "time_constant": 5.0}}
    mechanics, memory = stages(**faults)
    for _ in range(round(5.0 / H)):  # drive 0.8 for its time constant
        mechanics.throttle(memory, np.array([0.6]))
    heat = 0.64 * (1 - np.exp(-1))
    assert mechanics.duty(memory, np.array([1.0]))[0] == pytest.approx(1 - 0.5 * heat, rel=1e-3)


def test_a_servo_takes_from_the_duty_cycle_while_it_moves_and_while_it_holds():
    mechanics, memory = stages(brown_out={"moving": 0.6, "holding": 0.2})
    steered(mechanics, memory, *np.arange(1, 101) * 0.00625)  # 0.00625 in 2.5 ms: 2.5 a second
    # Half of the fastest, at 0.625: 1 - 0.6 / 2 - 0.2 x 0.625.
    assert mechanics.duty(memory, np.array([1.0]))[0] == pytest.approx(0.575)
    steered(mechanics, memory, 0.625)
    assert mechanics.duty(memory, np.array([1.0]))[0] == pytest.approx(0.875)


def test_a_battery_loses_its_share_in_a_minute_of_typical_driving():
    mechanics, memory = stages(battery_sag={"loss_per_minute": 0.3}, typical=2.0)
    for _ in range(round(60 / H / 10)):  # six seconds stand for a minute
        mechanics.drained(memory, np.array([2.0]))
    assert memory[0, MINUTES] == pytest.approx(0.1)
    memory[0, MINUTES] = 1.0
    assert mechanics.duty(memory, np.array([0.8]))[0] == pytest.approx(0.8 * 0.7)


def test_a_standing_car_draws_the_share_of_its_electronics():
    mechanics, memory = stages(battery_sag={"loss_per_minute": 0.3})
    for _ in range(400):  # 1 s
        mechanics.drained(memory, np.array([0.0]))
    assert memory[0, MINUTES] == pytest.approx(0.3 / 60)


def test_what_arrives_is_what_was_given_a_dead_time_ago():
    # 14 ms late, heard in four quarters of a period: 14 to 11.5 ms ago is command 2 (20 to 10 ms
    # ago); 11.5 to 9 ms ago is command 2 for 1.5 of 2.5 ms; then command 1.
    shares = command_weights(np.array([0.014]), 0.01, 4, 3)[0]
    assert shares == pytest.approx(
        np.array([[0, 0, 1, 0], [0, 0.4, 0.6, 0], [0, 1, 0, 0], [0, 1, 0, 0]])
    )
    assert command_weights(np.array([0.0]), 0.01, 4, 3)[0, :, 0] == pytest.approx(np.ones(4))
    assert command_weights(np.array([0.137]), 0.01, 4, 25).sum(-1) == pytest.approx(np.ones((1, 4)))
