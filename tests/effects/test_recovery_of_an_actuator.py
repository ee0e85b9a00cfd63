"""Effects of steering map, servo, supply and gear, concealed in the reference car, are recovered.

The reference car computes them in its own parts; the effects act on it as on a black box.
"""

from functools import cache

import pytest
from tensordict import TensorDict

from buggy_rl.effects.measuring import measured_options
from buggy_rl.estimation.gauss_newton import Problem, fitted
from buggy_rl.estimation.hypothesis import Library
from buggy_rl.estimation.noise_model import noise_model
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import cut_segments
from buggy_rl.policies.controllers.recording import recorded_steps
from buggy_rl.policies.controllers.room import RoomDriver
from buggy_rl.recordings import Recording
from buggy_rl.recordings.camera import Camera
from buggy_rl.simulators import make_engine

CONCEALED = {  # effect -> numbers, and the share by which the estimate may be off
    "steering_curve": ({"curvature": 0.35}, 0.1),
    "steering_end_stop": ({"left_cut": 0.5, "right_cut": 0.3}, 0.15),
    "steering_dead_zone": ({"width": 0.1}, 0.1),
    "servo_stiction": ({"width": 0.2}, 0.25),
    # Another curve of the lateral acceleration, and that of the roll.
    "steering_play": ({"width": 0.2}, 0.25),
    # The battery's own resistance counts with the motor's there.
    "voltage_sag": ({"resistance_ratio": 0.5}, 0.3),
    "gear_ratio": ({"ratio": 1.25}, 0.1),
    "brown_out": ({"moving": 0.6, "holding": 0.2}, 0.25),
    "thermal_foldback": ({"foldback": 0.7, "time_constant": 12.0}, 0.35),
}
FAST = ("steering_curve", "brown_out")


def make(count):
    return make_engine("reference", count)


@cache
def options():
    return measured_options(make)


def problem(faults, cars, steps):
    """Drives of a car with faults, against the car without."""
    engine = make_engine("reference", cars, faults=faults)
    motion = TensorDict.stack(list(recorded_steps(engine, RoomDriver(seed=3), steps)), 1)
    drives = [
        Recording(f"drive_{i}", Camera(seed=i).recorded(each), 0.01)
        for i, each in enumerate(motion.unbind(0))
    ]
    simulation = Simulation(make, options=options())
    segments = cut_segments(drives, 1.0, 1.0)
    library = Library(list(CONCEALED), {}, own=False)
    return Problem(simulation, segments, noise_model(simulation, segments), library)


def found(asked, effects):
    """Fits of single effects and of none, with their costs, by effect.

    From a prior scale off neutral, as a search begins at trial sizes: a stop at full lock is not
    felt where no command comes near it.
    """
    library, starts = asked.library, [asked.library.hypothesis([])]
    starts = [
        library.hypothesis([e], [1.0] * len(library.numbers(e)) + [0.0]) if e else starts[0]
        for e in effects
    ]
    fits = fitted(asked, starts)
    return {e: (fit, asked.cost(fit)) for e, fit in zip(effects, fits, strict=True)}


def recovered(effect, cars, steps):
    numbers, share = CONCEALED[effect]
    asked = problem({effect: numbers}, cars, steps)
    fits = found(asked, [effect, ""])
    for name, value in numbers.items():
        estimate = fits[effect][0].values()[effect][name]
        assert estimate == pytest.approx(value, rel=share, abs=0.05), name
    assert fits[effect][1] < fits[""][1] - 50  # [nats]
    return asked, fits


@pytest.mark.slow
@pytest.mark.parametrize("effect", FAST)
def test_a_concealed_effect_is_recovered(effect):
    recovered(effect, 2, 900)


@pytest.mark.slow
@pytest.mark.parametrize("effect", CONCEALED)
def test_a_concealed_effect_explains_more_than_any_other_of_them(effect):
    asked, fits = recovered(effect, 3, 2000)
    others = [e for e in asked.library.effects if e != effect]
    costs = [cost for _, cost in found(asked, others).values()]
    assert fits[effect][1] < min(costs) - 20  # [nats]


@pytest.mark.slow
def test_in_a_car_without_any_of_them_none_is_found():
    asked = problem({}, 3, 2000)
    fits = found(asked, [*asked.library.effects, ""])
    for effect in asked.library.effects:
        assert fits[effect][1] > fits[""][1] - 8.0, effect  # [nats]: no more than chance
