import math
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from buggy_rl.core import keys
from buggy_rl.core.vehicle import (
    GRAVITY,
    VehicleDimensions,
    integrate_pose,
    rotate,
    shift_velocity,
    similar_dimensions,
)
from buggy_rl.effects import effect_class, make_effect
from buggy_rl.effects.measuring import measured_options
from buggy_rl.effects.motion.base import Motion
from buggy_rl.effects.motion.fields import STREAM, air_of
from buggy_rl.effects.motion.steered import FrontAxle, steered_angle
from buggy_rl.simulators import make_engine
from tests.effects.faults import batched, fault, follow, neutral, over, start, step

ARM = VehicleDimensions().sensor_to_cg
RESISTANCES = (
    *("aerodynamic_drag", "rolling_resistance", "viscous_drag", "cornering_drag", "steering_drag"),
)
YAWING = ("one_sided_drag", "yaw_damping", "stiff_differential")
FORCES = (*RESISTANCES, "floor_slope", "wind", *YAWING)
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


@pytest.mark.parametrize(
    ("name", "values"),
    [("rolling_resistance", {"deceleration": 3.0}), ("steering_drag", {"per_angle": 8.0})],
)
def test_dry_friction_holds_a_car_that_its_motor_cannot_move(name, values):
    actions = torch.tensor([[-0.5, 0.9]]).expand(100, 2)
    gone = {}
    for effects in ((), (make_effect(name, values),)):
        env = over(list(effects), "single_track")
        state = follow(env, start(env, (0.0, 0.0, 0.0)), actions)[-1]
        gone[len(effects)] = float(torch.linalg.vector_norm(state[keys.POSE][..., :2]))
    assert gone[0] > 0.2
    assert gone[1] < 0.02


def test_less_friction_than_simulated_lets_a_car_roll_on_and_does_not_set_it_off():
    less = {"deceleration": -0.3}
    for speed, after in ((1.0, 1.3), (0.0, 0.0)):
        got = speeds(coasted("rolling_resistance", less, (speed, 0.0, 0.0)))
        assert float(got[-1]) == pytest.approx(after, abs=1e-3)


def test_cornering_drag_goes_with_the_square_of_the_lateral_acceleration_to_either_side():
    # vx r = 2 * 1.5 = 3 m/s^2: 0.02 of its square, 0.18 m/s^2, over 10 ms.
    for rate, lost in ((1.5, 0.0018), (-1.5, 0.0018), (3.0, 0.0072), (0.0, 0.0)):
        state = coasted("cornering_drag", {"coefficient": 0.02}, (2.0, 0.0, rate), 1)
        assert math.isclose(float(speeds(state)[0]), 2.0 - lost, abs_tol=1e-6)


@pytest.mark.parametrize("speed", [0.8, 2.0])
@pytest.mark.parametrize("side", [1, -1])
def test_steering_drag_goes_with_the_angle_of_the_wheels_whatever_the_speed(speed, side):
    # An engine without slip that turns about a point on the rear axle's line: L r / v = tan(delta).
    delta, d = 0.2, VehicleDimensions()
    rate = side * speed * math.tan(delta) / d.wheelbase
    at_sensor = (speed, (d.cg_to_rear_axle + d.sensor_to_cg) * rate, rate)
    env = over([make_effect("steering_drag", {"per_angle": 3.0}, stiffness=(0.0, 0.0))])
    state = follow(env, start(env, at_sensor), COASTING)
    lost = 0.01 * 3.0 * delta  # along the wheels
    at_cg = shift_velocity(state[0][keys.VELOCITY], -d.sensor_to_cg)
    assert float(at_cg[0]) == pytest.approx(speed - lost * math.cos(delta), abs=1e-4)
    across = -side * lost * math.sin(delta)
    assert float(at_cg[1] - d.cg_to_rear_axle * rate) == pytest.approx(across, abs=1e-4)
    turned = d.cg_to_front_axle * d.mass / d.yaw_inertia * across
    assert float(at_cg[2] - rate) == pytest.approx(turned, abs=2e-3)


@pytest.mark.parametrize(
    "engine",
    ["single_track", *(pytest.param(e, marks=pytest.mark.slow) for e in ("reference", "mujoco"))],
)
def test_the_angle_of_the_wheels_is_read_off_the_motion(engine):
    known = measured_options(lambda n: make_engine(engine, (n,)))["steering_drag"]
    axle = FrontAxle(known["stiffness"][0], known["friction"][0], known["shape"][0])
    commands = torch.tensor([[-0.5, 0.5], [-0.1, -0.4], [-0.3, 0.6]])
    env = make_engine(engine, (3,))
    state, velocities = start(env, (1.5, 0.0, 0.0)), []
    for _ in range(100):
        state = env.step(state.set(keys.ACTION, commands.clone()))["next"].exclude(keys.REWARD)
        velocities.append(state[keys.VELOCITY])
    before, after = (shift_velocity(v, -ARM) for v in velocities[-2:])
    motion = Motion(state[keys.POSE], before, after, commands, 0.01)
    read = steered_angle(motion, VehicleDimensions(), axle)
    for found, steering in zip(read.tolist(), commands[:, 1].tolist(), strict=True):
        turned = {
            "single_track": lambda s: math.tanh(1.1 * s) * 0.45,
            "reference": lambda s: s * (0.36 - 0.02 * s) + 0.008,
            "mujoco": lambda s: 0.36 * s,
        }[engine](steering)
        assert found == pytest.approx(turned, abs=0.03)


def test_wheels_of_a_car_that_runs_straight_are_straight_and_turn_with_a_yaw_acceleration():
    axle, dimensions = FrontAxle(stiffness=6.0), VehicleDimensions()
    straight = torch.tensor([[2.0, 0.0, 0.0]])
    turned = torch.tensor([[2.0, 0.0, 0.05]])

    def read(after):
        motion = Motion(torch.zeros(1, 3), straight, after, torch.zeros(1, 2), 0.01)
        return float(steered_angle(motion, dimensions, axle))

    assert read(straight) == 0.0
    # Side force over load: ay / g of 2 m/s 0.025 rad/s, and (I / m) 5 rad/s^2 / (g b).
    turning = dimensions.yaw_inertia / dimensions.mass * 5.0 / dimensions.cg_to_rear_axle
    share = (2.0 * 0.025 + turning) / GRAVITY
    path = math.atan2(0.025 * dimensions.cg_to_front_axle, 2.0)
    assert read(turned) == pytest.approx(path + share / axle.stiffness, rel=0.03)


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


def test_the_air_of_another_car_is_that_of_its_length_and_shape():
    assert air_of(VehicleDimensions()) == pytest.approx((STREAM, 2.0))
    # Ten times as long, with the mass of a similar one: a tenth of the stream [1/m].
    car = replace(similar_dimensions({"wheelbase": 1.74, "mass": 1625.0}), track_width=1.55 / 2)
    assert air_of(car) == pytest.approx((STREAM / 10, 4.0))
    push = {"force_x": 0.5, "force_y": 0.0}
    env = over([make_effect("wind", push, dimensions=car)])
    state = follow(env, start(env, (6.0, 0.0, 0.0)), COASTING)
    wind = math.sqrt(0.5 / (0.5 * (1 + 4.0) * STREAM / 10))
    along = STREAM / 10 * ((wind - 6.0) ** 2 + 6.0**2)
    assert float(speeds(state)[0]) == pytest.approx(6.0 + 0.01 * along, abs=2e-5)


@pytest.mark.parametrize("offset", [0.01, -0.01])
def test_a_motor_that_pushes_beside_the_middle_turns_the_car_with_its_force(offset):
    env = over([make_effect("torque_steer", {"offset": offset})], "single_track", (1,))
    motion = Motion(
        torch.zeros(1, 3),
        torch.tensor([[2.0, 0.0, 0.0]]),
        torch.tensor([[2.02, 0.0, 0.0]]),  # 2 m/s^2, beside 0.5 + 0.25 * 2.01 of coasting
        torch.tensor([[1.0, 0.0]]),
        0.01,
    )
    # dr/dt = -offset m F / (m I): the force over mass is 3.0025 m/s^2.
    d = VehicleDimensions()
    expected = -offset * d.mass / d.yaw_inertia * 3.0025 * 0.01
    effect = env.transform[0]
    assert float(effect._change(motion)[0, 2]) == pytest.approx(expected, rel=1e-3)
    idle = replace(motion, action=torch.tensor([[-1.0, 0.0]]))
    assert float(effect._change(idle)[0, 2]) == 0.0
    ends = follow(env, start(env, (1.0, 0.0, 0.0)), torch.tensor([[0.6, 0.0]]).expand(40, 2))
    assert float(ends[keys.VELOCITY][-1, 0, 2]) * offset < -1e-4


def test_a_locked_axle_resists_turning_until_its_wheels_slide():
    # Couple of both rear wheels: t / 2 N C t r / (2 v), N over mass g a / L, at most t / 2 N D.
    d = VehicleDimensions()
    values = {"coupling": 1.0}
    options = {"stiffness": (0.0, 0.0), "friction": (0.84, 0.84)}
    load = 9.80665 * d.cg_to_front_axle / d.wheelbase
    arm = 0.5 * d.track_width * d.mass / d.yaw_inertia
    for speed, rate, within in ((3.0, 0.02, 0.005), (0.3, 2.0, 0.12)):
        env = over([make_effect("stiff_differential", values, **options)])
        state = follow(env, start(env, (speed, 0.0, rate)), COASTING)[0]
        taken = (rate - float(state[keys.VELOCITY][2])) / 0.01
        linear = arm * load * 13.0 * 0.5 * d.track_width / speed  # [1/s]
        damping = min(linear, arm * load * 0.84 / rate)
        # Less what such a damping loses within the step.
        assert taken == pytest.approx(damping * rate / (1 + 0.005 * damping), rel=within)


def test_a_locked_axle_in_a_bend_slips_more_across_and_pulls_back():
    # 2 m/s and 2 rad/s to the left: tyres that slip along give less to the side, so that the rear
    # goes out; and the front wheels, which hold against the couple, pull back as they are turned.
    state = coasted("stiff_differential", {"coupling": 1.0}, (2.0, 0.0, 2.0), 1)[0]
    vx, vy, yaw_rate = shift_velocity(state[keys.VELOCITY], -ARM).tolist()
    still = shift_velocity(torch.tensor([2.0, 0.0, 2.0]), -ARM).tolist()
    assert vx < still[0] - 1e-4
    assert vy < still[1]
    assert yaw_rate < still[2]


def test_a_locked_axle_leaves_a_straight_alone():
    values = {"coupling": 1.0}
    straight = coasted("stiff_differential", values, (3.0, 0.0, 0.0), 5)
    assert torch.equal(straight[keys.VELOCITY][..., 2], torch.zeros(5))


def test_a_force_is_told_in_newtons_of_the_car_and_yaw_damping_beside_the_tyres_own():
    drag, pull = effect_class("viscous_drag"), effect_class("one_sided_drag")
    car, rate = VehicleDimensions(), {"rate": 0.4}
    assert "0.4 N for each m/s and each kilogram" in drag.sentence(rate)
    assert "0.65 N s/m at a car of 1.62 kg" in drag.said(rate, car)
    # I dr/dt = F t / 2: 0.0049 * 8 / 0.0775 = 0.506 N.
    assert "0.506 N at the wheel" in pull.said({"yaw_acceleration": 8.0}, car)
    assert "0.311 N for each kilogram" in pull.sentence({"yaw_acceleration": 8.0})
    damping = effect_class("yaw_damping").said({"rate": 6.0}, car)
    assert "behaves like" in damping
    # The tyres' own at 15 wheelbases a second, 2.61 m/s: 9.81 m a b (C_f a + C_r b) / (I L v).
    own = 9.80665 * 1.625 / 0.0049 * 0.081 * 0.093 * (6.1 * 0.081 + 9.4 * 0.093) / 0.174 / 2.61
    assert f"{100 * 6.0 / own:.2g} % more than by its tyres alone" in damping


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


@pytest.mark.parametrize(("moment", "side"), [(2.0, "left"), (-2.0, "right")])
def test_a_drag_on_one_side_is_said_to_be_on_the_side_that_it_turns_to(moment, side):
    said = effect_class("one_sided_drag").sentence({"yaw_acceleration": moment})
    assert side in said
    assert {"left": "right", "right": "left"}[side] not in said


def test_a_controllers_force_follows_what_it_wants_with_its_lag(monkeypatch):
    effect = make_effect("speed_controller_lag", time_constant=0.1)
    wanted = torch.zeros(3)
    monkeypatch.setattr(effect, "_controlled", lambda _: wanted)
    state, lost = torch.zeros(3, 2), 0.0
    for _ in range(31):  # the first step makes the force known
        change, state = effect._change_and_state(SimpleNamespace(state=state))
        lost = lost + change[:, 0]
        wanted = torch.tensor([0.0, 1.0, -2.0])
    held = wanted * (1 - math.exp(-0.3 / 0.1))
    torch.testing.assert_close(state[:, 0], held)
    # The force that is not there yet, over the 0.3 s.
    torch.testing.assert_close(lost, -0.1 * wanted * (1 - math.exp(-0.3 / 0.1)))
