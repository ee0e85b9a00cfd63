"""What an engine declares as realised is what a plant with that physics does."""

from functools import cache

import pytest
import torch
from benchmarks.grip import loss
from benchmarks.gripping.plants import maker
from benchmarks.inside import NUMBERS, rollouts
from tensordict import TensorDict

from buggy_rl.effects import effect_class
from buggy_rl.effects.measuring import measurable_options
from buggy_rl.estimation.inside import Inside
from buggy_rl.simulators import ENGINES
from buggy_rl.task.augment import augmented
from tests.contracts.test_engines import make, manoeuvre
from tests.simulators.steps import follow, start

CASES = [  # of the plants' own physics; the share of the wrapped effect's loss that is left at most
    *(("reference", effect, 0.25) for effect in ("payload",)),
    pytest.param("reference", "tire_grip", 0.25, marks=pytest.mark.slow),
    *(
        pytest.param("mujoco", effect, 0.3, marks=[pytest.mark.slow] * (effect != "tire_grip"))
        for effect in ("tire_grip", "grip_balance", "payload", "top_speed", "steering_asymmetry")
    ),
]
CARS = {"payload": 6}  # drives; of the rest 3, which the loss of a smaller effect does not settle
STANDING = torch.tensor([[-1.0, 0.0]]).expand(10, 2)  # rows: the memories of both are the same
ACTUATED = {  # of engines without a plant: effect, number, value
    "steering_dead_time": ("dead_time", 0.037),
    "throttle_dead_time": ("dead_time", 0.037),
    "viscous_drag": ("rate", 0.4),
    "top_speed": ("speed_ratio", 0.7),
    "tire_grip": ("grip", 0.6),
    "grip_balance": ("front_to_rear", 0.7),
}


@cache
def known(plant):
    """What wrapped effects are told of a plant, or of the single track."""
    return measurable_options(single if plant == "single_track" else maker(plant))[0]


@pytest.mark.parametrize(("plant", "effect", "share"), CASES)
def test_inside_it_is_closer_to_the_plant_than_around_it(plant, effect, share):
    values = NUMBERS[effect][1]
    value = values[len(values) // 2]
    shown, motions = rollouts(plant, effect, value, CARS.get(effect, 3), known(plant))
    left = {name: loss(motion, shown) for name, motion in motions.items()}
    assert left["inside"] < share * left["wrapped"]
    assert left["wrapped"] < left["bare"]


@pytest.mark.parametrize("name", sorted(ENGINES))
def test_at_neutral_numbers_every_parameter_is_as_declared(name):
    engine = make(name, 3)
    inside = Inside(engine.realises, engine.declared, list(engine.realises))
    neutral = {
        effect: {p.name: torch.full((3,), p.value) for p in effect_class(effect).declared}
        for effect in inside.changes
    }
    _, values = inside.moved(neutral, {})
    assert set(values) == {c.parameter for own in inside.changes.values() for c in own}
    assert all(bool((v == engine.values[n]).all()) for n, v in values.items())


@pytest.mark.parametrize("effect", ACTUATED)
def test_of_the_single_track_it_is_the_wrapped_effect_but_for_what_that_reads_off(effect):
    number, value = ACTUATED[effect]
    engine = single(2)  # two: kernels are of more than one
    values = {p.name: torch.full((2,), p.value) for p in effect_class(effect).declared}
    values[number] = torch.full((2,), value)
    inside = Inside(engine.realises, engine.declared, [effect])
    _, own = inside.moved({effect: values}, {})
    wrapped, _ = augmented(single(2), {effect: values}, {}, (), known("single_track"))
    with torch.no_grad():
        bare, within, around = (
            follow(env, start(env), torch.cat([STANDING, manoeuvre(120)]))[1][:, 0]
            for env in (engine, engine.with_parameters(TensorDict(own, [2])), wrapped)
        )
    changed = float((within - bare).norm())
    assert changed > 0.02
    assert float((within - around).norm()) < 0.2 * changed


def single(count):
    return make("single_track", count)
