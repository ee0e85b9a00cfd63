"""One car, recorded at 20, 50, 100 and 200 Hz: what is concealed in it is found at every rate.

It is driven at 200 Hz by commands that change every 50 ms at most, so that rows left out of its
recording are all that tells one rate from another.
"""

from functools import partial

import pytest
import torch

from buggy_rl.effects import effect_class
from buggy_rl.estimation.gauss_newton import Problem, fitted
from buggy_rl.estimation.hypothesis import Library
from buggy_rl.estimation.noise_model import noise_model
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import cut_segments, segment_rows, smoothing_rows
from buggy_rl.recordings import Recording
from buggy_rl.recordings.camera import Camera, CameraConfig
from buggy_rl.simulators import make_engine
from tests.diagnosis.planted import commands, driven

FINEST = 0.005  # [s]
SECONDS = 12.0
FEW_NOISE = CameraConfig(0.0005, 0.002, 0.005, 0.01)
PLANTED = {
    "nothing": {},
    "force": {"viscous_drag": {"rate": 0.5}},
    "command": {"steering_dead_time": {"dead_time": 0.06}},
    "servo": {"steering_rate_limit": {"rate": 4.0}},
    "play": {"steering_backlash": {"width": 0.2}},
    "sensor": {"speed_scale": {"ratio": 1.06}},
    "late": {"sensor_latency": {"dead_time": 0.06}},
}
RATES = (20, 50, 100, 200)


def single_track(count, dt):
    return make_engine("single_track", count, dt=dt)


@pytest.fixture(scope="module")
def true():
    """True motion of two drives of each case at 200 Hz."""
    rows, count = round(SECONDS / FINEST), 2 * len(PLANTED)
    action = commands(2, rows, seed=3)[:, ::45].repeat_interleave(40, 1)  # held for 0.2 s
    action = torch.cat([action] * 2, 1)[:, :rows].repeat(len(PLANTED), 1, 1)
    effects = {}
    for index, case in enumerate(PLANTED.values()):
        for name, values in case.items():
            own = {p.name: torch.full((count,), p.value) for p in effect_class(name).declared}
            for parameter, value in values.items():
                own[parameter][2 * index : 2 * index + 2] = value
            effects[name] = own
    return driven(single_track(count, FINEST), effects, {}, action)


def recorded(true, case, rate):
    """Two recordings at a rate, by leaving rows out."""
    first, keep = 2 * list(PLANTED).index(case), round(1 / FINEST / rate)
    camera = [Camera(FEW_NOISE, seed) for seed in (0, 1)]
    return [
        Recording(f"{case}_{i}", camera[i].recorded(true[first + i][::keep], 1 / rate), 1 / rate)
        for i in (0, 1)
    ]


def found(recordings, effects):
    """Values of effects, each fitted alone, by a simulator that is stepped at their rate.

    A late sensor and commands stamped as much too early are the same: their sum is told.
    """
    simulation = Simulation(partial(single_track, dt=recordings[0].dt))
    segments = cut_segments(recordings, 1.0, 1.0)
    problem = Problem(simulation, segments, noise_model(simulation, segments), Library(effects))
    fits = fitted(problem, [problem.library.hypothesis([effect]) for effect in effects], 6)
    values = [next(iter(fit.values()[e].values())) for fit, e in zip(fits, effects, strict=True)]
    clocks = [fit.values()[""]["clock_offset"] for fit in fits]
    late = ("sensor_latency", "steering_dead_time")
    pairs = zip(effects, values, clocks, strict=True)
    return [v + clock if e in late else v for e, v, clock in pairs]


SLOWER = pytest.mark.slow


@pytest.mark.parametrize(
    "rate", [pytest.param(rate, marks=[SLOWER] * (rate in (20, 200))) for rate in RATES]
)
@pytest.mark.parametrize(
    "case",
    [
        "force",
        *(pytest.param(c, marks=SLOWER) for c in ("command", "sensor", "servo", "play", "late")),
    ],
)
def test_what_is_concealed_is_found_at_every_rate(true, case, rate):
    [(effect, values)] = PLANTED[case].items()
    [planted] = values.values()
    [value] = found(recorded(true, case, rate), [effect])
    assert value == pytest.approx(planted, rel=0.05)


@pytest.mark.parametrize("rate", RATES)
def test_where_nothing_is_concealed_nothing_is_found_at_any_rate(true, rate):
    effects = ["viscous_drag", "steering_dead_time", "speed_scale"]
    drag, late, scale = found(recorded(true, "nothing", rate), effects)
    assert drag < 0.02  # [1/s] of 0.5
    assert abs(late) < 0.003  # [s] of 0.06
    assert abs(scale - 1) < 0.003


def test_segments_last_as_long_at_every_rate(true):
    for rate in RATES:
        segments = cut_segments(recorded(true, "nothing", rate), 1.0, 1.0)
        assert segments.horizon * segments.dt == pytest.approx(1.0)
        assert segments.start * segments.dt == pytest.approx(0.3)
        assert segments.earlier.shape[1] * segments.dt == pytest.approx(3.0)
        assert segments.pose.shape[1] == segment_rows(1.0, segments.dt)
        assert len(Simulation(single_track).instants(segments)) == 10


def test_the_parabola_is_odd_and_never_so_short_that_it_follows_the_noise():
    assert [smoothing_rows(1 / rate) for rate in RATES] == [5, 7, 15, 29]
