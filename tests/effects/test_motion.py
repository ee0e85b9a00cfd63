import math

import pytest
import torch

from buggy_rl import keys
from buggy_rl.effects import make_effect
from buggy_rl.effects.motion.fields import STREAM
from buggy_rl.engines import make_engine
from buggy_rl.vehicle import VehicleDimensions, integrate_pose, rotate, shift_velocity
from tests.effects.faults import batched, fault, follow, neutral, over, start, step

ARM = VehicleDimensions().sensor_to_cg
RESISTANCES = ("aerodynamic_drag", "rolling_resistance", "viscous_drag", "cornering_drag")
FORCES = (*RESISTANCES, "floor_slope", "wind", "one_sided_drag", "yaw_damping")
COASTING = torch.tensor([[-1.0, 0.0]])


def coasted(name, values, velocity, steps=100, pose=(0.0, 0.0, 0.0)):
    """States over an engine that keeps its velocity: what follows is the effect's alone."""
    env = over([make_effect(name, values)])
    return follow(env, start(env, velocity, pose), COASTING.expand(steps, 2))


def speeds(states):
    return states[keys.VELOCITY][..., 0]


TIME = 0.01 * torch.arange(1, 101)


def test_drag_follows_the_closed_form():
    # dv/dt = -c v^2: v(t) = v0 / (1 + c v0 t).
    got = speeds(coasted("aerodynamic_drag", {"coefficient": 0.2}, (3.0, 0.0, 0.0)))
    torch.testing.assert_close(got, 3.0 / (1 + 0.2 * 3.0 * TIME), atol=1e-5, rtol=0)


def test_viscous_drag_follows_the_closed_form():
    got = speeds(coasted("viscous_drag", {"rate": 0.7}, (3.0, 0.0, 0.0)))
    torch.testing.assert_close(got, 3.0 * torch.exp(-0.7 * TIME), atol=1e-5, rtol=0)


def test_rolling_resistance_takes_the_same_each_second_and_ends_at_rest():
    got = speeds(coasted("rolling_resistance", {"deceleration": 1.5}, (1.0, 0.0, 0.0)))
    torch.testing.assert_close(got[:50], 1.0 - 1.5 * TIME[:50], atol=1e-4, rtol=0)
    assert (got.diff() <= 0).all()
    assert 0 <= got[-1] < 1e-3


def test_cornering_drag_is_its_share_of_the_lateral_acceleration_to_either_side():
    # vx r = 2 * 1.5 = 3 m/s^2, a tenth of it over 10 ms.
    state = coasted("cornering_drag", {"coefficient": 0.1}, (2.0, 0.0, 1.5), 1)
    assert math.isclose(float(speeds(state)[0]), 2.0 - 0.003, abs_tol=1e-6)
    right = coasted("cornering_drag", {"coefficient": 0.1}, (2.0, 0.0, -1.5), 1)
    assert math.isclose(float(speeds(right)[0]), 2.0 - 0.003, abs_tol=1e-6)
    straight = coasted("cornering_drag", {"coefficient": 0.1}, (2.0, 0.0, 0.0), 1)
    assert float(speeds(straight)[0]) == 2.0


@pytest.mark.parametrize("name", RESISTANCES)
def test_no_resistance_moves_a_car_or_turns_it_round(name):
    strongest = {p.name: p.upper for p in make_effect(name).declared}
    for vx in (-2.0, -0.01, 0.0, 1e-4, 0.03, 2.0):
        got = speeds(coasted(name, strongest, (vx, 0.0, 3.0 if vx else 0.0), 50))
        assert (got * vx >= 0).all()
        assert (got.abs() <= abs(vx)).all()


@pytest.mark.parametrize("engine", ["single_track", "mujoco", "reference", "kinematic", "hold"])
def test_no_force_moves_a_standing_car(engine):
    # Held by its tyres: within a millimetre in 0.3 s, at sizes that are plainly felt; the first
    # car feels nothing, each of the others one force.
    felt = {name: fault(name) for name in FORCES}
    felt["floor_slope"] = {"along_x": 0.4, "along_y": 0.2}
    cars = [None, *FORCES]
    effects = [
        batched(name, [felt[name] if name == car else neutral(name) for car in cars])
        for name in FORCES
    ]
    env = over(effects, engine, (len(cars),))
    pose = follow(env, start(env), COASTING.expand(30, 2))[-1][keys.POSE]
    assert float((pose[1:] - pose[0]).abs().max()) < 1e-3


def test_a_slope_pulls_one_way_whatever_the_heading():
    # A car that heads along y feels a pull along x from its right.
    pull = {"along_x": 0.5, "along_y": 0.0}
    for yaw, expected in ((0.0, (0.5, 0.0)), (math.pi / 2, (0.0, -0.5)), (math.pi, (-0.5, 0.0))):
        state = coasted("floor_slope", pull, (2.0, 0.0, 0.0), 1, (0.0, 0.0, yaw))[0]
        gained = (state[keys.VELOCITY] - torch.tensor([2.0, 0.0, 0.0]))[:2] / 0.01
        torch.testing.assert_close(gained, torch.tensor(expected), atol=1e-4, rtol=0)


def test_wind_adds_to_the_air_that_the_car_drives_through_and_finds_twice_the_area_on_the_side():
    # At rest 0.5 m/s^2 = 1.5 c W^2: W = 7.0 m/s. Heading along it at 2 m/s, c (W - 2)^2 + c 2^2.
    wind = math.sqrt(0.5 / (1.5 * STREAM))
    along = STREAM * ((wind - 2.0) ** 2 + 2.0**2)
    against = -STREAM * ((wind + 2.0) ** 2 - 2.0**2)
    flow = math.hypot(wind, 2.0)  # heading along y: from ahead and from the left
    beside = (-STREAM * (flow - 2.0) * 2.0, -2.0 * STREAM * flow * wind)
    push = {"force_x": 0.5, "force_y": 0.0}
    for yaw, expected in ((0.0, (along, 0.0)), (math.pi, (against, 0.0)), (math.pi / 2, beside)):
        state = coasted("wind", push, (2.0, 0.0, 0.0), 1, (0.0, 0.0, yaw))[0]
        gained = (state[keys.VELOCITY] - torch.tensor([2.0, 0.0, 0.0]))[:2] / 0.01
        torch.testing.assert_close(gained, torch.tensor(expected), atol=2e-3, rtol=0)


def test_a_dragging_wheel_turns_the_car_about_its_centre_of_gravity():
    # 4 rad/s^2 over 10 ms at a speed where tanh(v / 0.3) = 1; the sensor, 22 mm ahead, is swung
    # to the left with it.
    state = coasted("one_sided_drag", {"yaw_acceleration": 4.0}, (3.0, 0.0, 0.0), 1)[0]
    expected = torch.tensor([3.0, 0.04 * ARM, 0.04])
    torch.testing.assert_close(state[keys.VELOCITY], expected, atol=1e-6, rtol=1e-5)


def test_yaw_damping_follows_the_closed_form_and_leaves_the_centre_of_gravity_alone():
    states = coasted("yaw_damping", {"rate": 2.0}, (2.0, 3.0 * ARM, 3.0), 50)
    rate = states[keys.VELOCITY][:, 2]
    torch.testing.assert_close(rate, 3.0 * torch.exp(-2.0 * TIME[:50]), atol=1e-5, rtol=0)
    at_cg = shift_velocity(states[keys.VELOCITY], -ARM)
    torch.testing.assert_close(at_cg[:, 1], torch.zeros(50), atol=1e-6, rtol=0)


@pytest.mark.parametrize("name", FORCES)
def test_the_pose_moves_by_the_midpoint_rule_with_the_new_velocity(name):
    velocity, pose = torch.tensor([2.0, 0.2, 1.5]), torch.tensor([40.0, -30.0, 0.7])
    state = coasted(name, fault(name), velocity.tolist(), 1, pose.tolist())[0]
    assert not torch.equal(state[keys.VELOCITY], velocity)
    expected = integrate_pose(pose, velocity, state[keys.VELOCITY], 0.01)
    torch.testing.assert_close(state[keys.POSE], expected, atol=5e-6, rtol=0)


@pytest.mark.parametrize("engine", ["single_track", "mujoco", "reference"])
def test_a_car_on_a_slope_drives_as_on_the_level_turned_with_it(engine):
    # Turning world, start and slope together turns the drive and changes nothing else.
    poses = []
    for turn in (0.0, 2.0):
        angle = torch.tensor(turn)
        x, y = rotate(torch.tensor([0.5, 0.2]), angle).tolist()
        env = over([make_effect("floor_slope", {"along_x": x, "along_y": y})], engine, (1,))
        actions = torch.tensor([[-0.2, 0.3]]).expand(40, 2)
        end = follow(env, start(env, (1.5, 0.0, 0.0), (0.0, 0.0, turn)), actions)[-1]
        poses.append(rotate(end[keys.POSE][..., :2], -angle.expand(1)))
    torch.testing.assert_close(poses[1], poses[0], atol=2e-4, rtol=0)


def test_drag_outside_the_engine_does_what_drag_inside_it_does():
    # The single track's own quadratic drag k over mass m is the effect with c = k / m. Without
    # lags, whose state at the start is a guess from the resistance.
    direct = dict.fromkeys(("throttle_lag", "throttle_dead_time"), 0.0)
    own = {**direct, "quadratic_drag": 0.02 + 0.1 * 1.625}
    drag = make_effect("aerodynamic_drag", {"coefficient": 0.1})
    envs = {
        "there": make_engine("single_track", parameters=own),
        "here": over([drag], make_engine("single_track", parameters=direct)),
        "without": make_engine("single_track", parameters=direct),
    }
    actions = torch.tensor([[0.0, 0.2]]).expand(100, 2)
    ends = {
        name: follow(env, start(env, (2.5, 0.0, 0.0)), actions)[-1][keys.POSE][:2]
        for name, env in envs.items()
    }
    missed = float((ends["without"] - ends["there"]).norm())
    assert missed > 0.2
    assert float((ends["here"] - ends["there"]).norm()) < 0.03 * missed


def test_a_step_does_nothing_to_the_state_it_came_from():
    env = over([make_effect("viscous_drag", {"rate": 1.0})])
    state = start(env, (2.0, 0.0, 0.0))
    step(env, state)
    assert torch.equal(state[keys.VELOCITY], torch.tensor([2.0, 0.0, 0.0]))
