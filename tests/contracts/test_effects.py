"""What every effect must prove, whatever moves the car beneath it."""

import math
import re
from functools import cache, partial

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import Compose, SerialEnv, TransformedEnv
from torchrl.envs.utils import check_env_specs

from buggy_rl.core import keys
from buggy_rl.effects import EFFECTS, STACK, effect_class, make_effect, make_effects
from buggy_rl.effects.base import EffectParameter
from tests.contracts.test_engines import make
from tests.effects.faults import batched, fault, follow, neutral, over, start

CONTRACT = {  # names and parameters that programs outside of this package rely on
    "throttle_dead_time": {"dead_time": "s"},
    "steering_dead_time": {"dead_time": "s"},
    "throttle_lag": {"time_constant": "s"},
    "steering_lag": {"time_constant": "s"},
    "steering_rate_limit": {"rate": "1/s"},
    "throttle_gain": {"gain": "-"},
    "steering_gain": {"gain": "-"},
    "throttle_offset": {"offset": "-"},
    "steering_offset": {"offset": "-"},
    "throttle_deadband": {"width": "-", "restored": "-"},
    "steering_backlash": {"width": "-"},
    "steering_asymmetry": {"left_to_right": "-"},
    "battery_sag": {"loss_per_minute": "1/min"},
    "aerodynamic_drag": {"coefficient": "1/m"},
    "rolling_resistance": {"deceleration": "m/s^2"},
    "viscous_drag": {"rate": "1/s"},
    "cornering_drag": {"coefficient": "s^2/m"},
    "steering_drag": {"per_angle": "m/(s^2 rad)"},
    "floor_slope": {"along_x": "m/s^2", "along_y": "m/s^2"},
    "wind": {"force_x": "m/s^2", "force_y": "m/s^2"},
    "one_sided_drag": {"yaw_acceleration": "rad/s^2"},
    "yaw_damping": {"rate": "1/s"},
    "torque_steer": {"offset": "m"},
    "stiff_differential": {"coupling": "-"},
    "understeer": {"gradient": "rad s^2/m"},
    "cornering_stiffness": {"ratio": "-"},
    "dive_steer": {"angle": "rad s^2/m"},
    "tire_grip": {"grip": "-", "max_acceleration": "m/s^2"},
    "grip_balance": {"front_to_rear": "-"},
    "grip_patch": {"x": "m", "y": "m", "radius": "m", "grip": "-"},
    "payload": {"mass_ratio": "-"},
    "motor_power_limit": {"power_per_mass": "W/kg"},
    "top_speed": {"speed_ratio": "-"},
    "sensor_latency": {"dead_time": "s"},
    "sensor_lag": {"time_constant": "s"},
    "sensor_yaw": {"angle": "rad"},
    "sensor_lever_arm": {"x": "m", "y": "m"},
    "pose_scale": {"ratio": "-"},
    "heading_drift": {"rate": "rad/s"},
    "speed_scale": {"ratio": "-"},
    "gyro_bias": {"bias": "rad/s"},
}
TERMS = (  # one of each kind, of each memory, of a product, of each group of shapes
    "term.yaw.throttle.even_square",
    "term.forward.steering.even",
    "term.side.speed_times_steering",
    "term.forward.throttle_rate",
    "term.side.heading.cos2",
    "term.steering.lateral_acceleration.saturating",
    "term.throttle.steering.linear.lag",
    "term.steering.time",
    "term.shown_left.lateral_acceleration",
    "term.shown_heading.yaw_rate.threshold",
)
SEEN = (keys.POSE, keys.VELOCITY, keys.MEASURED_POSE, keys.MEASURED_VELOCITY)
MOVING = (1.8, 0.1, 2.0)  # [m/s, m/s, rad/s] in a turn to the left
STEPS = 12


def actions(steps=STEPS):
    """A throttle that opens past half and a steering that swings through both sides."""
    time = torch.arange(steps) * 0.01
    return torch.stack([0.2 + 8 * time, torch.cos(25 * time)], -1)


def driven(env, steps=STEPS):
    return follow(env, start(env, MOVING, (0.3, -0.2, 0.5)), actions(steps))


def seen(states):
    """What may be seen of a drive [T, *, n]; measured is what is true where nothing changes it."""
    names = dict(zip(SEEN[2:], SEEN[:2], strict=True))
    return {key: states[key if key in states.keys() else names[key]] for key in SEEN}  # noqa: SIM118


def stacked(rows):
    """All effects, each with a set of values for each car."""
    return [batched(name, [row.get(name, neutral(name)) for row in rows]) for name in EFFECTS]


@pytest.fixture(params=[*EFFECTS, *TERMS])
def name(request):
    return request.param


@pytest.fixture(params=[*EFFECTS, *TERMS, "everything"])
def effects(request):
    """Makes the effects anew: one can be in one environment only."""
    if request.param == "everything":
        return lambda: make_effects({name: fault(name) for name in EFFECTS})
    return lambda: [make_effect(request.param, fault(request.param))]


def test_the_names_and_parameters_agreed_on_are_still_there():
    units = {n: {p.name: p.unit for p in effect_class(n).declared} for n in CONTRACT}
    assert units == CONTRACT


def test_each_effect_of_the_library_says_where_to_look_on_the_car():
    sentences = {name: effect_class(name).look_at for name in STACK}
    assert [name for name, said in sentences.items() if not said.endswith((".", "?"))] == []
    assert max(map(len, sentences.values())) <= 100
    assert len(set(sentences.values())) == len(STACK)


def test_it_says_what_it_is(name):
    cls = effect_class(name)
    assert cls.name == name
    assert cls.kind in ("actuation", "motion", "sensing")
    assert cls.equation
    assert "\n" not in cls.equation
    assert re.search(r"\b(19|20)\d\d\b", cls.source), "its source has no year"
    for p in cls.declared:
        assert isinstance(p, EffectParameter)
        assert p.lower <= p.value <= p.upper
        assert p.unit
        assert p.meaning.endswith(".")
        assert p.coordinate(p.value) == 0
        for coordinate in (0.5, 2.0):
            assert math.isclose(p.coordinate(p.value_at(coordinate)), coordinate, rel_tol=1e-4)


def test_its_sentence_tells_two_sizes_apart(name):
    cls = effect_class(name)
    large = {**neutral(name), **fault(name)}
    small = {
        p.name: p.value_at(0.3 * p.coordinate(large[p.name]))
        if p.reciprocal
        else p.value + 0.3 * (large[p.name] - p.value)
        for p in cls.declared
    }
    sentences = cls.sentence(large), cls.sentence(small)
    assert sentences[0] != sentences[1]
    for sentence in sentences:
        assert any(digit in sentence for digit in "0123456789")
        assert sentence[-1] != "."
        assert not any(key in sentence.split() for key in ("rad", "rad/s", "1/s"))


def test_it_keeps_its_specs(effects):
    for engine, batch_size in (("single_track", ()), ("learned", (4,)), ("hold", (2, 3))):
        env = over(effects(), make(engine, batch_size))
        check_env_specs(env)
        assert env.batch_size == batch_size


@pytest.mark.parametrize("engine", ["mujoco", "reference", "kinematic"])
def test_all_at_once_keep_their_specs_over_every_engine(engine):
    check_env_specs(over(make_effects({name: fault(name) for name in EFFECTS}), make(engine, (2,))))


@pytest.mark.parametrize("engine", ["single_track", "learned", "mujoco", "hold"])
def test_neutral_is_neutral_to_the_last_bit(engine):
    # One car for each effect, which only that car feels; and one that feels none.
    cars = [{name: fault(name)} for name in EFFECTS] + [{}]
    env, bare = over(stacked(cars), make(engine, (len(cars),))), make(engine, (len(cars),))
    shown, truth = seen(driven(env)), driven(bare)
    for key, plain in zip(SEEN, (keys.POSE, keys.VELOCITY) * 2, strict=True):
        assert torch.equal(shown[key][:, -1], truth[plain][:, -1]), key
    felt = {  # an engine without tyres or motor has nothing that some effects could act on
        name: any(
            not torch.equal(shown[key][:, car], truth[plain][:, car])
            for key, plain in zip(SEEN, (keys.POSE, keys.VELOCITY) * 2, strict=True)
        )
        for car, name in enumerate(EFFECTS)
    }
    if engine in ("single_track", "mujoco"):
        assert [name for name in EFFECTS if not felt[name]] == []


def test_effects_that_nobody_feels_leave_no_trace():
    bare = driven(make("single_track", (3,)))
    env = over(stacked([{}] * 3), make("single_track", (3,)))
    states = driven(env)
    assert set(states.keys()) == set(bare.keys())
    for key in bare.keys():  # noqa: SIM118
        assert torch.equal(states[key], bare[key]), key


def test_cars_with_values_of_their_own_drive_as_they_would_alone(name):
    half = {p: 0.5 * (v + neutral(name)[p]) for p, v in fault(name).items()}
    rows = [half, neutral(name), fault(name)]
    together = seen(driven(over([batched(name, rows)], make("single_track", (3,)))))
    alone = seen(driven(over([make_effect(name, rows[2])], make("single_track"))))
    for car, expected in ((1, without()), (2, alone)):
        for key in SEEN:
            torch.testing.assert_close(
                together[key][:, car], expected[key], atol=2e-5, rtol=2e-5, msg=f"{key}, car {car}"
            )


@cache
def without():
    """What is seen of a single track that feels no effect."""
    return seen(driven(make("single_track")))


def test_two_steps_from_one_tensordict_are_equal_and_leave_it_as_it_was(effects):
    env = over(effects(), make("single_track", (4,)))
    state = driven(env)[-1].clone().set(keys.ACTION, torch.full((4, 2), 0.3))
    before = state.clone()
    first = env.step(state.copy())["next"].clone()
    assert (state == before).all()
    driven(env, 3)  # whatever happens in between
    second = env.step(state.copy())["next"]
    for key in sorted(first.keys()):
        assert torch.equal(first[key], second[key]), key


def test_a_reset_of_some_cars_leaves_the_others_as_they_are(effects):
    env = over(effects(), make("single_track", (4,)))
    state = driven(env)[-1].exclude(keys.REWARD)
    mask = torch.tensor([True, False, False, True])
    after = env.reset(state.clone().set("_reset", mask[:, None]), select_reset_only=True)
    fresh = env.reset()
    for key in sorted(fresh.keys()):
        assert torch.equal(after[key][~mask], state[key][~mask]), key
        assert torch.equal(after[key][mask], fresh[key][mask]), key


def test_it_stays_finite_at_its_bounds(name):
    cls = effect_class(name)
    rows = [{**fault(name), p.name: bound} for p in cls.declared for bound in (p.lower, p.upper)]
    states = driven(over([batched(name, rows)], make("single_track", (len(rows),))), 30)
    for key, value in seen(states).items():
        assert value.isfinite().all(), key


def test_a_little_more_of_it_changes_little(name):
    # Along the whole way from neutral to the fault, in steps of 1 %: no step may be a jump.
    cls = effect_class(name)
    shares = torch.linspace(0.0, 1.0, 101).tolist()
    rows = [
        {p.name: float(p.value_at(share * p.coordinate(fault(name)[p.name]))) for p in cls.declared}
        for share in shares
    ]
    engine = make("single_track", (len(rows),))
    env = over([batched(name, rows)], engine)
    shown = seen(follow(env, start(env, MOVING, elapsed=(30.0,)), actions(25)))
    for key in SEEN:
        value = shown[key]
        way = (value[:, -1] - value[:, 0]).norm(dim=(0, -1))
        jump = (value[:, 1:] - value[:, :-1]).norm(dim=(0, -1)).max()
        assert jump <= 0.1 * way + 1e-4, f"{key}: a jump of {jump} on a way of {way}"


def test_it_drives_alike_inside_a_batch_of_environments(effects):
    lone = over(effects(), make("single_track", (2,)))
    expected = follow(lone, lone.reset(), actions(6))
    several = SerialEnv(2, partial(_fresh, effects))
    states = follow(several, several.reset(), actions(6))
    several.close()
    for which in (0, 1):
        for key in (keys.POSE, keys.VELOCITY):
            torch.testing.assert_close(states[key][:, which], expected[key], atol=0, rtol=0)


def _fresh(effects):
    return over(effects(), make("single_track", (2,)))


def test_a_wrong_value_is_refused_with_what_would_be_right(name):
    parameter = effect_class(name).declared[0]
    beyond = parameter.upper * 2 + 1
    with pytest.raises(ValueError, match=rf"{name}.*{parameter.name}.*outside.*neutral is"):
        make_effect(name, {parameter.name: beyond})
    with pytest.raises(ValueError, match=f"no parameter wrong; available: {parameter.name}"):
        make_effect(name, {"wrong": 1.0})
    with pytest.raises(ValueError, match="not a number"):
        make_effect(name, {parameter.name: "much"})


def test_a_fit_may_step_out_of_the_bounds(name):
    parameter = effect_class(name).declared[0]
    beyond = torch.tensor([parameter.upper * 1.5 + 0.1, parameter.lower * 1.5 - 0.1])
    rest = {p.name: torch.full((2,), fault(name)[p.name]) for p in effect_class(name).declared}
    values = TensorDict({**rest, parameter.name: beyond}, [2])
    effect = make_effect(name).with_parameters(values)
    assert torch.equal(effect.values[parameter.name], beyond)
    assert driven(over([effect], make("single_track", (2,))))[keys.POSE].isfinite().all()


def test_values_for_another_number_of_cars_are_refused(name):
    effect = batched(name, [fault(name), neutral(name)])
    with pytest.raises(ValueError, match=rf"{name}.*\[2\].*\[3\]"):
        check_env_specs(over([effect], make("hold", (3,))))


def test_it_can_be_told_again_what_it_is(name):
    effect = make_effect(name, fault(name), dt=0.02)
    copy = make_effect(name, {k: float(v) for k, v in effect.values.items()}, **effect.options)
    assert copy.values == effect.values
    assert copy.options == effect.options == {"dt": 0.02}
    assert effect.with_parameters(TensorDict({}, [])).options == effect.options


def test_effects_come_in_their_order_however_they_are_written():
    backwards = make_effects({name: fault(name) for name in reversed(EFFECTS)})
    assert tuple(effect.name for effect in backwards) == tuple(EFFECTS)
    kinds = [effect.kind for effect in backwards]
    assert kinds == sorted(kinds)  # actuation, motion, sensing


def test_an_unknown_effect_is_refused_with_what_there_is():
    with pytest.raises(ValueError, match=r"no effect 'aero'; available: aerodynamic_drag"):
        make_effect("aero")


def test_no_step_mixes_devices(name, monkeypatch):
    # Meta tensors have a device but no content: what runs on them runs on a GPU as well.
    effect = make_effect(name, fault(name)).to("meta")
    state = TensorDict(
        {
            keys.POSE: torch.zeros(4, 3, device="meta"),
            keys.VELOCITY: torch.zeros(4, 3, device="meta"),
        },
        [4],
    )
    reset = effect._reset(state.empty(), state.clone())
    acted = effect._inv_call(reset.clone().set(keys.ACTION, torch.zeros(4, 2, device="meta")))
    after = effect._step(acted, state.clone())
    assert {str(value.device) for value in (*acted.values(), *after.values())} == {"meta"}


def test_a_users_own_effect_stands_behind_those_of_its_kind(tmp_path):
    file = tmp_path / "own.py"
    file.write_text(
        "from buggy_rl.effects.motion.base import MotionEffect, along\n"
        "from buggy_rl.effects.base import EffectParameter\n"
        "class Magnet(MotionEffect):\n"
        "    name = 'magnet'\n"
        "    equation = 'dvx/dt = pull'\n"
        "    declared = (EffectParameter('pull', 0.0, -5.0, 5.0, 'm/s^2', 'Ahead.', 1.0, 0.1),)\n"
        "    def _change(self, motion):\n"
        "        return along(self._value('pull') * self.dt + 0 * motion.speed)\n"
    )
    own = f"{file}:Magnet"
    made = make_effects({own: {"pull": 2.0}, "gyro_bias": {}, "wind": {}})
    assert [effect.name for effect in made] == ["wind", "magnet", "gyro_bias"]
    env = TransformedEnv(make("hold"), Compose(*made))
    # 2 m/s^2 for 10 ms
    assert math.isclose(float(driven(env, 1)[0][keys.VELOCITY][0]), 1.8 + 0.02, rel_tol=1e-6)
