import math
from functools import cache

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import TransformedEnv

from buggy_rl.core import keys
from buggy_rl.core.keys import MEMORY
from buggy_rl.core.vehicle import GRAVITY, VehicleDimensions
from buggy_rl.effects import make_effect
from buggy_rl.effects.measuring import measured_options
from buggy_rl.effects.measuring.tyres import measured_tyres
from buggy_rl.effects.tyre.law import law, slip_of, slope
from buggy_rl.effects.tyre.stiffness import SlipChange
from buggy_rl.simulators import make_engine
from buggy_rl.simulators.reference import ReferenceEngine
from tests.effects.faults import follow, over, start

DRIVES, STEPS = 32, 100
KEPT = {"single_track": -0.5, "mujoco": -0.4, "reference": -0.15}  # throttles that keep 2.5 m/s
GRIP = 0.7
LESS = {  # parameters of an engine whose own friction is less, at the same stiffness
    "single_track": {
        "front_grip": GRIP,
        "rear_grip": GRIP,
        "front_stiffness": 1 / GRIP,
        "rear_stiffness": 1 / GRIP,
    },
    "mujoco": {"grip_front": GRIP, "grip_rear": GRIP},
    "reference": {"grip": GRIP},
}


def changed(engine, factors, count=DRIVES):
    lone = make_engine(engine, (count,))
    values = {name: (lone.values[name] * factor).expand(count) for name, factor in factors.items()}
    return lone.with_parameters(TensorDict(values, [count]))


def rollout(engine, env, throttle=None):
    """Positions [T, N, 2] of cars that set off at 1 to 3 m/s and are steered up to full lock."""
    kept = KEPT[engine] if throttle is None else throttle
    generator = torch.Generator().manual_seed(0)
    knots = torch.rand(DRIVES, 2, 6, generator=generator) * 2 - 1
    actions = torch.nn.functional.interpolate(knots, STEPS, mode="linear", align_corners=True)
    more, steering = actions.permute(2, 0, 1).unbind(-1)
    actions = torch.stack([0.25 * more + kept, (1.3 * steering).clamp(-1, 1)], -1)
    velocity = torch.zeros(DRIVES, 3)
    velocity[:, 0] = 1.0 + 2.0 * torch.rand(DRIVES, generator=generator)
    given = TensorDict({keys.VELOCITY: velocity, keys.POSE: torch.zeros(DRIVES, 3)}, [DRIVES])
    return follow(env, env.reset(given, set_state=True), actions)[keys.POSE][..., :2]


def gap(a, b):
    """Root mean square of a drive, mean of the drives [m]: no one that spins outweighs the rest."""
    return float((a - b).square().sum(-1).mean(0).sqrt().mean())


@cache
def bare_rollout(engine):
    return rollout(engine, make_engine(engine, (DRIVES,)))


@cache
def less_rollout(engine):
    return rollout(engine, changed(engine, LESS[engine]))


@cache
def options(engine):
    return measured_options(lambda n: make_engine(engine, (n,)))


def closed(engine, name, values, truth):
    """Share of the gap in position over 1 s rollouts that the effect closes."""
    bare = bare_rollout(engine)
    effect = make_effect(name, values, **options(engine)[name])
    repaired = rollout(engine, over([effect], engine, (DRIVES,)))
    assert gap(bare, truth) > 0.01
    return 1 - gap(repaired, truth) / gap(bare, truth)


@pytest.mark.parametrize(
    ("engine", "least"),
    [
        ("single_track", 0.85),
        pytest.param("mujoco", 0.7, marks=pytest.mark.slow),
        pytest.param("reference", 0.55, marks=pytest.mark.slow),
    ],
)
def test_less_grip_outside_the_engine_does_what_less_grip_inside_it_does(engine, least):
    assert closed(engine, "tire_grip", {"grip": GRIP}, less_rollout(engine)) > least


@pytest.mark.parametrize(
    ("front", "least"), [pytest.param(0.5, 0.3, marks=pytest.mark.slow), (1.0, 0.0)]
)
def test_what_the_front_axle_drives_the_rear_one_has_left_for_the_side(front, least):
    def car(factors, count=DRIVES):
        lone = changed("single_track", factors, count)
        share = torch.full((count,), front)
        return lone.with_parameters(TensorDict({"front_drive_share": share}, [count]))

    known = measured_options(lambda n: car({}, n))["tire_grip"]
    assert known["front_drive_share"] == front
    gunned = 0.1
    bare, less = (rollout("single_track", car(f), gunned) for f in ({}, LESS["single_track"]))
    closes = []
    for share in (front, 0.0):
        effect = make_effect("tire_grip", {"grip": GRIP}, **known | {"front_drive_share": share})
        repaired = rollout("single_track", TransformedEnv(car({}), effect), gunned)
        closes.append(1 - gap(repaired, less) / gap(bare, less))
    assert closes[0] > least
    assert closes[1] < closes[0] - 0.2


def test_each_driving_axle_spins_by_itself():
    four = make_effect("tire_grip", {"grip": 0.4}, front_drive_share=0.5)
    env = over([four], "single_track", (1,))
    spin = opened_wide(env)["tire_grip" + MEMORY]
    assert spin.shape[-1] == 2
    assert float(spin[30:].amax((0, 1)).min()) > 0.1
    with pytest.raises(ValueError, match="must be within"):
        make_effect("tire_grip", front_drive_share=1.2)


def test_the_wrong_amount_of_grip_does_worse():
    right, wrong = (
        closed("single_track", "tire_grip", {"grip": grip}, less_rollout("single_track"))
        for grip in (GRIP, 0.9)
    )
    assert wrong < right - 0.2


def test_a_shifted_balance_outside_does_what_one_inside_does():
    factors = {"grip_front": math.sqrt(0.8), "grip_rear": 1 / math.sqrt(0.8)}
    truth = rollout("mujoco", changed("mujoco", factors))
    assert closed("mujoco", "grip_balance", {"front_to_rear": 0.8}, truth) > 0.6


AXLES = {  # cornering stiffness of front and rear axle of an engine
    "single_track": ("front_stiffness", "rear_stiffness"),
    "mujoco": ("cornering_stiffness_front", "cornering_stiffness_rear"),
    "reference": ("front_cornering_stiffness", "rear_cornering_stiffness"),
}


@pytest.mark.parametrize(
    ("engine", "least"),
    [("single_track", 0.8), pytest.param("reference", 0.8, marks=pytest.mark.slow)],
)
def test_softer_tyres_outside_the_engine_do_what_softer_tyres_inside_it_do(engine, least):
    truth = rollout(engine, changed(engine, dict.fromkeys(AXLES[engine], 0.6)))
    assert closed(engine, "cornering_stiffness", {"ratio": 0.6}, truth) > least
    assert closed(engine, "cornering_stiffness", {"ratio": 0.9}, truth) < least - 0.3


@pytest.mark.parametrize(
    ("engine", "least"),
    [("single_track", 0.75), pytest.param("mujoco", 0.8, marks=pytest.mark.slow)],
)
def test_understeer_is_a_front_axle_of_less_cornering_stiffness(engine, least):
    truth = rollout(engine, changed(engine, {AXLES[engine][0]: 0.6}))
    # 1 / (0.6 C) = 1 / C + k g below the limit.
    stiffness = options(engine)["understeer"]["stiffness"][0]
    gradient = (1 / 0.6 - 1) / (stiffness * GRAVITY)
    assert closed(engine, "understeer", {"gradient": gradient}, truth) > least
    assert closed(engine, "cornering_stiffness", {"ratio": 0.6}, truth) < least - 0.3


@pytest.mark.parametrize(
    "gradient", [0.012, *(pytest.param(g, marks=pytest.mark.slow) for g in (0.004, -0.004))]
)
def test_a_steady_turn_loses_the_gradient_times_its_lateral_acceleration(gradient):
    # delta = L r / v + K ay: of both cars the same, of one less gradient ay.
    ends = []
    effect = make_effect(
        "understeer", {"gradient": gradient}, **options("single_track")["understeer"]
    )
    for env in (make_engine("single_track", (1,)), over([effect], "single_track", (1,))):
        states = follow(
            env, start(env, (2.2, 0.0, 0.0)), torch.tensor([[-0.4, 0.25]]).expand(150, 2)
        )
        vx, _, yaw_rate = states[-1][keys.VELOCITY][0].tolist()
        ends.append((vx, yaw_rate))
    stiff = options("single_track")["understeer"]["stiffness"]
    own = (1 / stiff[0] - 1 / stiff[1]) / GRAVITY
    needed = [0.174 * r / v + own * v * r for v, r in ends]
    lateral = ends[1][0] * ends[1][1]
    assert lateral > 1.0
    assert needed[0] - needed[1] == pytest.approx(gradient * lateral, rel=0.12)


def test_a_car_that_speeds_up_steers_itself_and_one_that_keeps_its_speed_does_not():
    values = {"angle": 0.01}
    effect = make_effect("dive_steer", values, **options("single_track")["dive_steer"])
    env = over([effect], "single_track", (1,))
    faster = follow(env, start(env, (1.0, 0.0, 0.0)), torch.tensor([[0.6, 0.0]]).expand(40, 2))
    slower = follow(env, start(env, (2.5, 0.0, 0.0)), torch.tensor([[-1.0, 0.0]]).expand(40, 2))
    assert float(faster[-1][keys.VELOCITY][0, 2]) > 0.1
    assert float(slower[-1][keys.VELOCITY][0, 2]) < -0.02


@pytest.mark.parametrize("compliance", [0.1, 0.02, 0.0, -0.008])
def test_the_slip_of_a_compliant_axle_solves_its_equation(compliance):
    numbers = make_effect("understeer", {"gradient": 0.01})._tensor("numbers")
    change = SlipChange.of(numbers, slice(1, 2))
    slip = torch.linspace(-6.0, 6.0, 201).expand(2, 201)
    load = (GRAVITY * change.share).expand(2, 201)
    ones, zeros = torch.ones(201), torch.zeros(201)
    ratio = torch.stack([ones, ones, compliance * ones, zeros])
    now, steep = change._slip_now(slip, ratio, load)
    gives = compliance * change.stiffness * GRAVITY / change.shape
    gives = gives * torch.tensor([[1.0], [0.0]])
    torch.testing.assert_close(now + gives * law(now, change.shape), slip, atol=2e-3, rtol=2e-3)
    assert (now.diff(dim=-1) > 0).all()  # no two slips of the simulated car are one of the changed
    assert torch.equal(now[1], slip[1])
    numeric = law(now, change.shape).diff(dim=-1) / slip.diff(dim=-1) / change.shape
    torch.testing.assert_close(numeric, 0.5 * (steep[:, 1:] + steep[:, :-1]), atol=0.03, rtol=0)


def test_the_tyres_of_a_simulator_are_found():
    # The single track's D; C = B C D; and its shape factor, from presets/buggy.yaml.
    found = measured_tyres(lambda n: make_engine("single_track", (n,)), VehicleDimensions())
    assert found["friction"] == pytest.approx([0.85, 0.9], rel=0.01)
    assert found["stiffness"] == pytest.approx([7 * 1.2 * 0.85, 8.5 * 1.2 * 0.9], rel=0.03)
    assert found["shape"] == pytest.approx([1.2, 1.2], rel=0.02)


def test_what_resists_at_the_body_is_told_from_what_does_inside_of_motor_and_gear():
    mass = VehicleDimensions().mass
    # All of MuJoCo's is a force on the chassis, rolling 0.8 N and 0.4 N s/m of the speed with some
    # of its square. The reference car's motor and gear lose more than half of what it loses.
    at_the_body = options("mujoco")["tire_grip"]["resistance"]
    speed = 2.5
    felt = at_the_body[0] + at_the_body[1] * speed
    assert felt == pytest.approx((0.8 + 0.4 * speed + 0.02 * speed**2) / mass, rel=0.25)
    coasting = options("reference")["motor_power_limit"]["coasting"]
    share = options("reference")["tire_grip"]["resistance"][1] / coasting[1]
    assert 0.1 < share < 0.6
    assert "resistance" in make_effect("tire_grip", **options("mujoco")["tire_grip"]).options


def test_a_drive_that_is_not_seen_takes_from_the_side_as_well():
    def turned(resistance):
        tires = make_effect("tire_grip", {"grip": 0.6}, resistance=resistance)
        env = over([tires], "mujoco")
        states = follow(env, start(env, (2.5, 0.0, 0.0)), torch.tensor([[-0.2, 0.5]]).expand(40, 2))
        return float(states[-1][keys.VELOCITY][1])  # the tail hangs out more: less is left for it

    assert turned((0.5, 0.3)) < turned((0.0, 0.0)) - 0.01


def test_measured_options_are_what_the_effects_take():
    for name, values in options("single_track").items():
        effect = make_effect(name, values)
        assert set(effect.options) <= set(values)


def test_a_simulator_that_is_not_finite_is_refused():
    broken = {"mass": 1e30, "drive_force": float("nan")}
    with pytest.raises(ValueError, match="not finite"):
        measured_options(lambda n: changed("single_track", broken, n))


def test_a_bound_on_the_lateral_acceleration_is_kept():
    env = over([make_effect("tire_grip", {"max_acceleration": 3.0})], "single_track")
    states = follow(env, start(env, (2.5, 0.0, 0.0)), torch.tensor([[-0.4, 0.8]]).expand(80, 2))
    vx, _, yaw_rate = states[keys.VELOCITY][40:].unbind(-1)
    held = vx * yaw_rate  # of a turn that has become steady
    assert float(held.max()) < 3.3
    assert float(held.min()) > 2.0


def test_a_car_on_a_slippery_floor_turns_no_faster_than_friction_allows():
    env = over([make_effect("tire_grip", {"grip": 0.4})], "mujoco", (1,))
    states = follow(env, start(env, (2.5, 0.0, 0.0)), torch.tensor([[-0.7, 1.0]]).expand(60, 2))
    vx, _, yaw_rate = states[keys.VELOCITY][30:, 0].unbind(-1)
    assert float((vx * yaw_rate).mean()) < 1.15 * 0.4 * 0.9 * GRAVITY


@pytest.mark.parametrize("name", ["tire_grip", "grip_balance", "grip_patch"])
def test_a_car_that_rolls_straight_ahead_does_not_feel_its_tyres(name):
    values = {
        "tire_grip": {"grip": 0.6},
        "grip_balance": {"front_to_rear": 0.7},
        "grip_patch": {"x": 1.0, "y": 0.0, "radius": 5.0, "grip": 0.6},
    }
    env, bare = over([make_effect(name, values[name])], "single_track"), make_engine("single_track")
    actions = torch.tensor([[-0.8, 0.0]]).expand(20, 2)
    ends = [follow(e, start(e, (2.0, 0.0, 0.0)), actions)[-1] for e in (env, bare)]
    torch.testing.assert_close(ends[0][keys.POSE], ends[1][keys.POSE], atol=1e-4, rtol=0)


def opened_wide(env, actions=None):
    """A drive [T, 1]: in a bend the throttle is opened wide."""
    return follow(env, start(env, (1.5, 0.0, 0.0)), WIDE if actions is None else actions)


WIDE = torch.tensor([[-0.5, 0.5]] * 30 + [[0.8, 0.5]] * 50)


def test_a_car_that_spins_its_wheels_on_a_slippery_floor_has_nothing_left_for_the_side():
    # The concealed car's wheels spin, the engine's under the effect do not.
    slippery = opened_wide(ReferenceEngine((1,), faults={"tire_grip": {"grip": 0.55}}))
    known = options("reference")["tire_grip"]
    env = over([make_effect("tire_grip", {"grip": 0.55, **known})], "reference", (1,))
    states = opened_wide(env)
    spin = states["tire_grip" + MEMORY][..., 0]
    assert float(spin[:25].abs().max()) < 0.1  # it rolls through the bend
    assert float(spin[30:].max()) > 1.0
    bare = opened_wide(make_engine("reference", (1,)))
    bare, true, repaired = (s[keys.VELOCITY][:, 0, 2] for s in (bare, slippery, states))
    before, left = ((yaw_rate - true).square().mean().sqrt() for yaw_rate in (bare, repaired))
    assert float(left) < 0.5 * float(before)


def test_wheels_that_spun_stop_spinning_without_throttle():
    env = over([make_effect("tire_grip", {"grip": 0.5})], "reference", (1,))
    off = torch.cat([WIDE, torch.tensor([[-1.0, 0.5]] * 50)])
    spin = opened_wide(env, off)["tire_grip" + MEMORY][:, 0, 0]
    assert float(spin[30:80].max()) > 1.0
    assert abs(float(spin[-1])) < 0.1


def test_a_patch_is_slippery_inside_only():
    def turned(x):
        patch = {"x": x, "y": 0.0, "radius": 0.5, "grip": 0.4}
        env = over([make_effect("grip_patch", patch)], "single_track")
        states = follow(env, start(env, (2.0, 0.0, 0.0)), torch.tensor([[-0.5, 1.0]]).expand(20, 2))
        return states[-1][keys.VELOCITY]

    bare = make_engine("single_track")
    there = follow(bare, start(bare, (2.0, 0.0, 0.0)), torch.tensor([[-0.5, 1.0]]).expand(20, 2))
    far, near = turned(10.0), turned(0.2)
    torch.testing.assert_close(far, there[-1][keys.VELOCITY], atol=1e-5, rtol=0)
    assert float(near[2]) < 0.8 * float(far[2])


def test_only_the_axle_that_stands_on_a_patch_slides():
    # The sensor is at the origin, the axles 0.06 m before and 0.11 m behind it; the edge of the
    # patch lies between. A car that slides to the left is pushed to the right by both axles.
    def turned(x):
        patch = {"x": x, "y": 0.0, "radius": 2.0, "grip": 0.3}
        env = over([make_effect("grip_patch", patch)], "single_track")
        state = follow(env, start(env, (2.0, 1.0, 0.0)), torch.tensor([[-1.0, 0.0]]))[-1]
        return float(state[keys.VELOCITY][2])

    neither = turned(10.0)
    assert turned(2.0) > neither + 0.05  # the front one holds less: the tail is pushed to the right
    assert turned(-2.05) < neither - 0.05


def test_the_tyre_law_its_inverse_and_its_slope_belong_together():
    shape, slip = torch.tensor(1.2), torch.linspace(0.05, 2.0, 20, dtype=torch.float64)
    use = law(slip, shape)
    torch.testing.assert_close(slip_of(use, shape), slip, atol=1e-6, rtol=1e-6)
    h = 1e-4
    numeric = (law(slip + h, shape) - law(slip - h, shape)) / (2 * h * shape)
    torch.testing.assert_close(slope(slip, shape), numeric, atol=1e-6, rtol=1e-5)


def test_tyres_that_cannot_be_are_refused():
    with pytest.raises(ValueError, match="friction is 0"):
        make_effect("tire_grip", {"grip": 0.7}, friction=0)


def test_forces_are_read_off_with_the_inertia_and_axles_of_the_simulator():
    factors = {"yaw_inertia": 0.7, "cg_to_front_axle": 1.15}
    assert "dimensions" not in options("mujoco")["tire_grip"]
    known = measured_options(lambda n: changed("mujoco", factors, n))["tire_grip"]
    car = VehicleDimensions()
    assert known["dimensions"] == pytest.approx(
        {
            "yaw_inertia": 0.7 * car.yaw_inertia,
            "cg_to_front_axle": 1.15 * car.cg_to_front_axle,
            "sensor_to_cg": car.sensor_to_cg + 0.15 * car.cg_to_front_axle,
        },
        abs=1e-5,
    )
    friction = options("mujoco")["tire_grip"]["friction"]
    assert known["friction"] == pytest.approx(friction, rel=0.02)


def test_a_car_leans_as_high_as_its_centre_of_gravity():
    assert options("mujoco")["tire_grip"]["height"] == pytest.approx(0.045, rel=0.15)
    assert options("reference")["tire_grip"]["height"] == pytest.approx(0.045, rel=0.2)
    assert options("single_track")["tire_grip"]["height"] == pytest.approx(0.0, abs=1e-3)


def test_no_bit_of_the_grip_depends_on_how_many_cars_there_are():
    places = torch.rand(4096, 2, generator=torch.Generator().manual_seed(0))
    patch = make_effect("grip_patch", {"x": 0.5, "y": 0.5, "radius": 0.3, "grip": 0.5})
    together = patch._grip_at(places)
    for first in range(0, 4096, 16):
        few = slice(first, first + 33)
        assert torch.equal(together[few], patch._grip_at(places[few]))
