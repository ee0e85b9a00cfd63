"""Composed physics beside the terms of the grammar."""

import math

import pytest
import torch
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.effects.terms.grammar import Term
from buggy_rl.proof.cases.term_forms import has_form, sorts_with_terms
from buggy_rl.proof.plants.composed import Disturbance, Sort
from buggy_rl.proof.score.terms import in_grammar, matches, term_column


def drive(rows=600):
    """A slalom at 2 m/s with a throttle that comes and goes."""
    t = 0.01 * torch.arange(rows)
    steering = 0.6 * torch.sin(2 * math.pi * t / 2.3)
    rate = 2.0 * torch.sin(2 * math.pi * (t - 0.1) / 2.3)
    yaw = 0.01 * rate.cumsum(0)
    speed = 2.0 + 0.3 * torch.sin(t)
    pose = torch.stack(
        [0.01 * (speed * yaw.cos()).cumsum(0), 0.01 * (speed * yaw.sin()).cumsum(0), yaw], -1
    )
    velocity = torch.stack([speed, torch.zeros(rows), rate], -1)
    action = torch.stack([-0.2 + 0.5 * torch.cos(1.7 * t), steering], -1)
    return TensorDict({keys.POSE: pose, keys.VELOCITY: velocity, keys.ACTION: action}, [rows])


@pytest.mark.parametrize(
    ("name", "term", "typical"),
    [
        ("forward.steering.linear.none", "term.forward.steering", 1.0),
        ("side.speed.linear.none", "term.side.speed", 2.0),
        ("forward.yaw_rate.even.none", "term.forward.yaw_rate.even", 3.0),
        ("steering.throttle.square.none", "term.steering.throttle.even_square", 1.0),
    ],
)
def test_a_sort_of_the_grammar_is_its_term_with_the_coefficient_of_its_size(name, term, typical):
    found = matches(Disturbance(name, {"size": 0.6}), [drive()])
    best = next(iter(found.values()))
    assert best.name == term
    assert best.misfit < 0.01
    assert best.alike
    assert best.coefficient == pytest.approx(0.6 / typical, rel=0.01)
    assert in_grammar(found) == best


def test_the_coefficient_of_a_throttle_is_of_a_drive():
    found = matches(Disturbance("throttle.lateral.linear.none", {"size": 0.4}), [drive()])
    # Command from -1 to 1, drive from 0 to 1; at 5 m/s^2 the signal of the sort is 1.
    coefficient = found["term.throttle.lateral_acceleration"].coefficient
    assert coefficient == pytest.approx(0.5 * 0.4 / 5.0, rel=0.01)


def test_what_repeats_along_the_way_is_no_term():
    found = matches(Disturbance("forward.way.linear.none", {"size": 1.0, "phase": 0.3}), [drive()])
    assert in_grammar(found) is None
    assert min(match.misfit for match in found.values()) > 0.5


def test_what_never_acts_is_no_term():
    late = Disturbance("steering.throttle.threshold.heat", {"size": 1.0, "time_constant": 1e6})
    assert in_grammar(matches(late, [drive()])) is None


def test_another_time_constant_is_the_same_form_with_a_misfit():
    numbers = {"size": 1.0, "time_constant": 0.6}
    match = matches(Disturbance("forward.steering.linear.lag", numbers), [drive()])[
        "term.forward.steering.linear.lag"
    ]
    assert match.alike
    assert match.right
    assert match.misfit > 0.05


def test_a_term_with_a_lag_follows_a_step_by_its_time_constant():
    rows = drive(100)
    rows[keys.ACTION][:, 1] = 1.0
    rows[keys.ACTION][0, 1] = 0.0
    shown = term_column(Term.parse("term.forward.steering.linear.lag"), rows)
    assert shown[0] == 0.0
    assert shown[20] == pytest.approx(1 - math.exp(-1.0), rel=1e-6)  # LAG is 0.2 s


def test_forms_are_compared_by_all_four_parts():
    sort = Sort.named("steering.lateral.square.none")
    assert has_form(Term.parse("term.steering.lateral_acceleration.odd_square"), sort)
    assert not has_form(Term.parse("term.steering.lateral_acceleration.even"), sort)
    assert not has_form(Term.parse("term.yaw.lateral_acceleration.odd_square"), sort)
    assert not has_form(Term.parse("term.steering.yaw_rate.odd_square"), sort)


def test_sorts_with_terms_have_no_time_constant_of_minutes_and_no_way():
    found = sorts_with_terms()
    assert len(found) > 50
    assert not any(part in name for name in found for part in (".heat", ".play", ".way", ".place"))
