"""What effects of brakes, reverse or a speed controller must prove; the others are next door."""

import math
import re

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import Compose, TransformedEnv
from torchrl.envs.utils import check_env_specs

from buggy_rl.core import keys
from buggy_rl.core.longitudinal import ONE_WAY, LongitudinalCommand
from buggy_rl.effects import EFFECTS, OF_A_COMMAND, STACK, effect_class, make_effect, offered
from buggy_rl.simulators import make_engine
from tests.effects.faults import follow, neutral, start

COMMANDS = {
    "throttle_brake_reverse": "throttle_brake_reverse",
    "speed": {"kind": "speed", "reverse": True},
}
PARAMETERS = {
    "brake_gain": {"gain": "-"},
    "brake_balance": {"shift": "-"},
    "reverse_deadband": {"width": "-", "restored": "-"},
    "drag_brake": {"deceleration": "m/s^2"},
    "speed_controller_lag": {"time_constant": "s"},
    "driven_axle_slip": {"slip_per_acceleration": "s^2/m"},
    "speed_ramp": {"acceleration": "m/s^2"},
    "least_speed": {"speed": "m/s"},
    "speed_integral": {"rate": "1/s"},
}


def test_an_error_of_one_sensor_is_not_offered_where_that_sensor_measured_nothing():
    every = offered(ONE_WAY)
    for derived, missing in (
        ((), set()),
        (("yaw_rate",), {"gyro_bias"}),
        (("vx", "vy", "yaw_rate"), {"speed_scale", "gyro_bias"}),
    ):
        assert set(every) - set(offered(ONE_WAY, derived)) == missing
    assert {"pose_scale", "heading_drift"} <= set(offered(ONE_WAY, ("vx", "vy", "yaw_rate")))


@pytest.fixture(params=OF_A_COMMAND)
def name(request):
    return request.param


def engine(name, batch_size=()):
    """A car with the kind of command that the effect needs."""
    return make_engine("single_track", batch_size, command=COMMANDS[OF_A_COMMAND[name][1]])


def fault(name, share=2.0):
    return {
        p.name: float(p.value_at(share * p.coordinate(p.value + p.probe)))
        for p in effect_class(name).declared
    }


def batched(name, rows):
    values = {key: torch.tensor([row[key] for row in rows]) for key in rows[0]}
    return make_effect(name, rest=0.0).with_parameters(TensorDict(values, [len(rows)]))


def over(name, effect, batch_size=()):
    return TransformedEnv(engine(name, batch_size), Compose(effect))


def actions(steps=36):
    """Drive, brake in a bend, and roll without a command."""
    time = torch.arange(steps) * 0.01
    whole = steps / 60
    throttle = torch.where(time < 0.1 * whole, 0.5, torch.where(time < 0.4 * whole, -0.7, 0.0))
    return torch.stack([throttle, 0.5 * torch.cos(5 * time)], -1)


def driven(env, steps=36):
    return follow(env, start(env, (1.8, 0.1, 2.0), (0.3, -0.2, 0.5)), actions(steps))


def test_the_names_and_parameters_are_those_agreed_on():
    units = {n: {p.name: p.unit for p in effect_class(n).declared} for n in OF_A_COMMAND}
    assert units == PARAMETERS


def test_it_is_offered_only_where_there_is_such_a_command(name):
    assert name not in EFFECTS
    for kind in ("throttle", "throttle_brake_reverse", "speed", "current"):
        named = offered(LongitudinalCommand(kind))
        assert (name in named) == (OF_A_COMMAND[name][1] == kind)
        assert named == [n for n in STACK if n in named]  # in the stack's order
    assert offered(ONE_WAY) == list(EFFECTS)


def test_it_says_what_it_is_and_how_much(name):
    cls = effect_class(name)
    assert cls.name == name
    assert re.search(r"\b(19|20)\d\d\b", cls.source), "its source has no year"
    large, small = ({**neutral(name), **fault(name, share)} for share in (2.0, 1.0))
    assert cls.sentence(large) != cls.sentence(small)
    for p in cls.declared:
        assert p.coordinate(p.value) == 0
        assert math.isclose(p.coordinate(p.value_at(0.5)), 0.5, rel_tol=1e-4)


def test_it_keeps_its_specs(name):
    for batch_size in ((), (2, 3)):
        check_env_specs(over(name, make_effect(name, fault(name), rest=0.0), batch_size))


def test_it_is_felt_and_neutral_is_neutral_to_the_last_bit(name):
    rows = [fault(name), neutral(name)]
    shown = driven(over(name, batched(name, rows), (2,)))
    truth = driven(engine(name, (2,)))
    for key in (keys.POSE, keys.VELOCITY):
        assert torch.equal(shown[key][:, 1], truth[key][:, 1])
        assert (shown[key][:, 0] - truth[key][:, 0]).abs().max() > 1e-4


@pytest.mark.parametrize("kind", ["brake_gain", "reverse_deadband", "drag_brake", "brake_balance"])
def test_a_car_without_reverse_does_not_feel_it(kind):
    plain = make_engine("single_track", (2,))
    env = TransformedEnv(make_engine("single_track", (2,)), Compose(make_effect(kind, fault(kind))))
    felt, truth = driven(env), driven(plain)
    for key in (keys.POSE, keys.VELOCITY):
        assert torch.equal(felt[key], truth[key])


def test_cars_with_values_of_their_own_drive_as_they_would_alone(name):
    rows = [fault(name), neutral(name), fault(name, 1.0)]
    together = driven(over(name, batched(name, rows), (3,)))
    for car in (0, 2):  # neutral is compared to the last bit above
        alone = driven(over(name, make_effect(name, rows[car], rest=0.0)))
        for key in (keys.POSE, keys.VELOCITY):
            torch.testing.assert_close(together[key][:, car], alone[key], atol=2e-5, rtol=2e-5)


def test_two_steps_from_one_tensordict_are_equal(name):
    env = over(name, make_effect(name, fault(name), rest=0.0), (4,))
    state = driven(env, 12)[-1].clone().set(keys.ACTION, torch.full((4, 2), -0.3))
    first = env.step(state.copy())["next"].clone()
    driven(env, 5)  # whatever happens in between
    second = env.step(state.copy())["next"]
    for key in sorted(first.keys()):
        assert torch.equal(first[key], second[key]), key


def test_a_reset_of_some_cars_leaves_the_others_as_they_are(name):
    env = over(name, make_effect(name, fault(name), rest=0.0), (4,))
    state = driven(env, 12)[-1].exclude(keys.REWARD)
    mask = torch.tensor([True, False, False, True])
    after = env.reset(state.clone().set("_reset", mask[:, None]), select_reset_only=True)
    fresh = env.reset()
    for key in sorted(fresh.keys()):
        assert torch.equal(after[key][~mask], state[key][~mask]), key
        assert torch.equal(after[key][mask], fresh[key][mask]), key


def test_it_stays_finite_at_its_bounds_and_beyond(name):
    cls, rows = effect_class(name), []
    for p in cls.declared:
        wide = (p.lower, p.upper, p.upper * 1.5 + 0.1, p.lower * 1.5 - 0.1)
        rows += [{**fault(name), p.name: value} for value in wide]
    states = driven(over(name, batched(name, rows), (len(rows),)))
    assert states[keys.POSE].isfinite().all()
    assert states[keys.VELOCITY].isfinite().all()


def test_a_little_more_of_it_changes_little(name):
    shares = torch.linspace(0.0, 2.0, 101).tolist()
    rows = [fault(name, share) for share in shares]
    states = driven(over(name, batched(name, rows), (len(rows),)), 60)
    for key in (keys.POSE, keys.VELOCITY):
        way = (states[key][:, -1] - states[key][:, 0]).norm(dim=(0, -1))
        jump = states[key].diff(dim=1).norm(dim=(0, -1)).max()
        assert jump <= 0.1 * way + 1e-4, f"{key}: a jump of {jump} on a way of {way}"


def test_it_can_be_told_again_what_it_is(name):
    effect = make_effect(name, fault(name), dt=0.02, rest=0.0)
    copy = make_effect(name, {k: float(v) for k, v in effect.values.items()}, **effect.options)
    assert copy.values == effect.values
    assert copy.options == effect.options == {"dt": 0.02, "rest": 0.0}


def test_no_step_mixes_devices(name):
    effect = make_effect(name, fault(name), rest=0.0).to("meta")
    zeros = torch.zeros(4, 3, device="meta")
    state = TensorDict({keys.POSE: zeros, keys.VELOCITY: zeros.clone()}, [4])
    reset = effect._reset(state.empty(), state.clone())
    given = reset.clone().set(keys.ACTION, torch.zeros(4, 2, device="meta"))
    after = effect._step(effect._inv_call(given), state.clone())
    assert {str(value.device) for value in after.values()} == {"meta"}
