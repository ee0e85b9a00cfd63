"""Terms: their names, their equations, and that a bank of them is each of them."""

import pickle

import pytest
import torch

from buggy_rl.core import keys
from buggy_rl.effects import effect_class, make_effect, make_effects
from buggy_rl.effects.terms.grammar import (
    KINDS,
    NAMED,
    PLACES,
    SHAPES,
    SIGNALS,
    Term,
    number_in_bank,
    terms,
    terms_of,
)
from tests.effects.faults import batched, fault, follow, over, start

CARS = 16
MOVING = (1.8, 0.1, 2.0)  # [m/s, m/s, rad/s]


def driven(effects, steps=25, cars=CARS):
    time = 0.01 * torch.arange(steps).unsqueeze(-1) * torch.linspace(1.0, 2.0, cars)
    actions = torch.stack([0.2 + 0.5 * torch.sin(9 * time), 0.9 * torch.cos(12 * time)], -1)
    env = over(effects, "single_track", (cars,))
    state, states = start(env, MOVING, (2.3, -2.2, 0.5), elapsed=(60.0,)), []
    for action in actions:
        state = env.step(state.clone().set(keys.ACTION, action))["next"]
        states.append(state)
    return torch.stack(states)


def shown(states):
    have = states.keys()
    pose = keys.MEASURED_POSE if keys.MEASURED_POSE in have else keys.POSE
    velocity = keys.MEASURED_VELOCITY if keys.MEASURED_VELOCITY in have else keys.VELOCITY
    return torch.cat([states[pose], states[velocity]], -1)


def test_a_name_is_read_back_as_the_term_it_is_of():
    assert [Term.parse(term.name) for term in terms()] == list(terms())
    assert len({term.name for term in terms()}) == len(terms())


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("term.wheels.speed", "no place 'wheels'; available: forward, side, yaw"),
        ("term.yaw.colour", "no signal 'colour'; available: one, speed"),
        ("term.yaw.speed.round", "no shape 'round'; available: linear, even"),
        ("term.yaw.speed.linear.years", "no memory 'years'; available: none, lag"),
        ("term.yaw.speed_times_steering_times_throttle", "one signal or two, not 3"),
        ("term.yaw.heading.even", "are those of the heading"),
        ("term.yaw", "names no term"),
    ],
)
def test_what_the_grammar_does_not_have_is_refused_by_name(name, said):
    with pytest.raises(ValueError, match=said):
        make_effect(name)


def test_a_term_that_is_an_effect_of_the_library_is_not_searched():
    searched = {(t.place, t.signals, t.shape) for t in terms()}
    assert not searched & set(NAMED)
    for effect in set(NAMED.values()):
        assert effect_class(effect).name == effect


@pytest.mark.parametrize("kind", KINDS)
def test_a_bank_is_each_of_its_terms_to_the_last_bit(kind):
    chosen = terms_of(kind)[:: max(1, len(terms_of(kind)) // (CARS - 1))][:CARS]
    numbers = [2.0 * term.size for term in chosen]
    rows = [
        {"member": float(number_in_bank(term)), "coefficient": number}
        for term, number in zip(chosen, numbers, strict=True)
    ]
    rows += [{"member": 0.0, "coefficient": 0.0}] * (CARS - len(rows))
    together = shown(driven([batched(f"terms.{kind}.0", rows)]))
    bare = shown(driven([]))
    for car, (term, number) in enumerate(zip(chosen, numbers, strict=True)):
        own = [{"coefficient": number if i == car else 0.0} for i in range(CARS)]
        alone = shown(driven([batched(term.name, own)]))
        assert torch.equal(together[:, car], alone[:, car]), term.name
        assert not torch.equal(alone[:, car], bare[:, car]), term.name


@pytest.mark.parametrize(
    ("key", "effect", "values", "coefficient"),
    [
        (("steering", ("one",), "linear"), "steering_offset", {"offset": 0.02}, 0.02),
        (("throttle", ("throttle",), "linear"), "throttle_gain", {"gain": 1.02}, 0.02),
        (("forward", ("speed",), "linear"), "viscous_drag", {"rate": 0.1}, -0.1),
        (("forward", ("speed",), "even_square"), "aerodynamic_drag", {"coefficient": 0.02}, -0.02),
        (("yaw", ("yaw_rate",), "linear"), "yaw_damping", {"rate": 0.3}, -0.3),
        (("shown_yaw_rate", ("one",), "linear"), "gyro_bias", {"bias": 0.02}, 0.02),
        (("shown_heading", ("one",), "linear"), "sensor_yaw", {"angle": 0.01}, 0.01),
    ],
)
def test_terms_that_are_left_out_are_those_effects(key, effect, values, coefficient):
    assert NAMED[key] == effect
    term = Term(*key)
    by_effect, by_term = (
        shown(driven([make_effect(name, own)], cars=4)) - shown(driven([], cars=4))
        for name, own in ((effect, values), (term.name, {"coefficient": coefficient}))
    )
    rows = slice(0, 3) if effect == "sensor_yaw" else slice(0, 6)  # it turns velocities, too
    assert float((by_effect - by_term)[..., rows].norm()) < 0.06 * float(
        by_effect[..., rows].norm()
    )


def test_prior_scales_shift_a_rollout_of_a_second_by_about_ten_times_the_noise():
    bare = shown(driven([], steps=100, cars=4))
    for place in PLACES:
        name = Term(place, ("yaw_rate",), "saturating").name
        moved = shown(driven([make_effect(name, fault(name))], steps=100, cars=4)) - bare
        way = float(moved[-1, :, :2].norm(dim=-1).max())
        seen = float(moved.abs().max())
        assert 0.005 < max(way, seen) < 1.0, place


def test_every_part_of_the_grammar_says_itself_in_words():
    for term in terms():
        for number in (0.3, -0.3):
            sentence = term.sentence(number)
            assert "coefficient" not in sentence
            assert any(digit in sentence for digit in "0123456789")
            assert not {"rad", "rad/s", "rad/s^2", "1/s"} & set(sentence.split())
        assert "coefficient" in term.equation
        assert "{" not in term.equation
    assert {s for t in terms() for s in t.signals} == set(SIGNALS)
    assert {t.shape for t in terms()} == set(SHAPES)


def test_torque_steer_and_its_like_have_the_name_that_the_field_gives_them():
    assert "roll steer" in Term("steering", ("lateral_acceleration",)).sentence(-0.01)
    assert "brown-out" in Term("throttle", ("steering",), "even").sentence(-0.2)


def test_a_term_is_pickled_by_its_name():
    term = make_effect("term.side.speed_times_steering.linear.lag", {"coefficient": 0.25})
    copy = pickle.loads(pickle.dumps(term))
    assert type(copy) is type(term)
    assert copy.values == term.values


def test_terms_stand_behind_the_effects_of_their_kind():
    made = make_effects(
        {"term.shown_vx.one": {}, "gyro_bias": {}, "term.yaw.steering": {}, "wind": {}}
    )
    kinds = [effect.kind for effect in made]
    assert kinds == sorted(kinds)
    assert [e.name for e in made] == ["wind", "term.yaw.steering", "gyro_bias", "term.shown_vx.one"]


def test_a_sensor_s_term_is_taken_out_of_what_it_shows_to_first_order():
    pose, velocity = torch.randn(CARS, 7, 3), torch.randn(CARS, 7, 3)
    chosen = terms_of("sensing")[:: len(terms_of("sensing")) // CARS][:CARS]
    rows = [{"member": float(number_in_bank(t)), "coefficient": 1e-3 * t.size} for t in chosen]
    bank = batched("terms.sensing.0", rows)
    seen = [x.unflatten(0, (CARS,)) for x in (pose, velocity)]
    back = bank.unsensed(*seen, 0.01)
    moved = max(float((a - b).abs().max()) for a, b in zip(back, (pose, velocity), strict=True))
    assert 0 < moved < 1e-2
    alone = make_effect(chosen[3].name, {"coefficient": rows[3]["coefficient"]})
    for together, one in zip(back, alone.unsensed(pose[3], velocity[3], 0.01), strict=True):
        torch.testing.assert_close(together[3], one)


def test_a_lag_follows_a_step_with_its_time_constant():
    name = "term.steering.steering.linear.lag"
    env = over([make_effect(name, {"coefficient": 0.1})], "hold")
    state = start(env, MOVING)
    actions = torch.tensor([[0.0, 0.0]] * 5 + [[0.0, 0.5]] * 20)
    memory = follow(env, state, actions)[f"{name}_memory"][..., 0]
    expected = 0.5 * (1 - torch.exp(-0.01 * torch.arange(1, 21) / 0.2))
    torch.testing.assert_close(memory[5:], expected, atol=1e-5, rtol=1e-4)
