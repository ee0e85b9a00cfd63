"""Faults of the reference car that need brakes, reverse or a speed controller."""

from functools import cache

import pytest
import torch

from buggy_rl.simulators import make_engine
from buggy_rl.simulators.reference.faults import COMMAND_OF, NEUTRAL, OF_A_COMMAND, effect_of
from tests.simulators.test_reverse import driven

SIZES = {
    "brake_gain.gain": 0.6,
    "brake_balance.shift": 0.4,
    "reverse_deadband.width": 0.15,
    "drag_brake.deceleration": 1.0,
    "speed_controller_lag.time_constant": 0.15,
    "driven_axle_slip.slip_per_acceleration": 0.05,
    "speed_ramp.acceleration": 1.0,
    "least_speed.speed": 0.6,
    "speed_integral.rate": 3.0,
}
MANOEUVRE = [(0.5, 0.3, 70), (-0.7, 0.3, 40), (0.0, 0.0, 20), (-0.5, 0.0, 40)]
SPEED = {"kind": "speed", "reverse": True}


def cars(command, *rows):
    """A car for each row of faults."""
    names = {name for row in rows for name in row}
    faults = {n: torch.tensor([row.get(n, NEUTRAL[n]) for row in rows]) for n in names}
    return make_engine("reference", len(rows), command=command).with_faults(faults)


@cache
def manoeuvred(kind):
    """Velocities of a car without a fault and of one with each fault of a command, by fault."""
    command = SPEED if kind == "speed" else kind
    names = ["", *(name for name in SIZES if COMMAND_OF[effect_of(name)] == kind)]
    engine = cars(command, {}, *({name: SIZES[name]} for name in names[1:]))
    return dict(zip(names, driven(engine, MANOEUVRE)[0].unbind(1), strict=True))


def test_each_has_a_size_here():
    assert set(SIZES) == {fault.name for fault in OF_A_COMMAND}


@pytest.mark.parametrize("name", SIZES)
def test_it_is_felt_by_the_command_that_has_it_and_refused_by_the_others(name):
    kind = COMMAND_OF[effect_of(name)]
    moved = manoeuvred(kind)
    assert (moved[""] - moved[name]).abs().max() > 0.02
    with pytest.raises(ValueError, match=f"fault {name} is one of a car whose command is {kind}"):
        make_engine("reference", 1, command="throttle", faults={name: SIZES[name]})


def test_the_brakes_take_less_with_a_gain_below_1():
    engine = cars("throttle_brake_reverse", {}, {"brake_gain.gain": 0.6})
    right, weak = driven(engine, [(0.5, 0.3, 70), (-0.7, 0.3, 20)])[0].unbind(1)
    assert torch.equal(right[:70], weak[:70])  # nothing of it while it drives
    lost, lost_weak = (v[69, 0] - v[-1, 0] for v in (right, weak))
    assert 0.5 < lost_weak / lost < 0.9  # 0.6 of the brakes, all of the resistance


def test_the_drag_brake_stops_a_car_without_a_command():
    engine = cars("throttle_brake_reverse", {}, {"drag_brake.deceleration": 1.0})
    free, slowed = driven(engine, [(0.0, 0.0, 60)], 2.0)[0][..., 0].unbind(1)
    # 1 m/s^2 from when the duty cycle of the drive before has faded, 0.2 at 8/s.
    more = (free[30] - free[59]) - (slowed[30] - slowed[59])
    assert -float(more) / 0.29 == pytest.approx(1.0, rel=0.08)


def test_the_parameters_of_a_kind_of_command_are_its_own():
    with pytest.raises(KeyError, match="full_current"):
        make_engine("reference", 1, parameters={"full_current": 10.0})
    engine = make_engine("reference", 2, command="current", parameters={"full_current": 10.0})
    assert engine.with_faults({"payload.mass_ratio": torch.ones(2)}).command.kind == "current"


def test_a_ramp_is_the_fastest_change_of_the_setpoint():
    engine = cars(SPEED, {}, {"speed_ramp.acceleration": 1.0})
    plain, ramped = driven(engine, [(0.5, 0.0, 125)])[0][..., 0].unbind(1)
    assert float(plain[60]) > 1.2
    # 1 m/s^2, late by the controller's own time constant of 1.6 / 16 s.
    assert float(ramped[120] - ramped[70]) == pytest.approx(0.5, rel=0.05)


def test_below_the_least_speed_it_rolls_and_above_it_obeys():
    least, slow, fast = {"least_speed.speed": 0.6}, 0.1, 0.2  # setpoints of 0.5 and 1 m/s
    throttle = torch.tensor([slow, slow, fast, fast, slow])
    first = torch.tensor([2.0, 2.0, 2.0, 2.0, 0.0])
    engine = cars(SPEED, {}, least, {}, least, least)
    vx = driven(engine, [(throttle, 0.0, 100)], first)[0][..., 0]
    assert vx[59, 1] > vx[59, 0] + 0.1
    assert not vx[-1, 3] > vx[-1, 2] + 0.1
    assert float(vx[:, 4].abs().max()) < 0.01


def test_integral_action_reaches_the_setpoint_that_a_proportional_one_misses():
    engine = cars(SPEED, {}, {"speed_integral.rate": 2.0})
    plain, integral = driven(engine, [(0.4, 0.0, 200)], 1.8)[0][..., 0].unbind(1)
    assert float(plain[-1]) < 1.95  # of 2 m/s
    assert float(integral[-1]) == pytest.approx(2.0, abs=0.01)
