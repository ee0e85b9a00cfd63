import math

import pytest
import torch
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.effects import make_effect, make_effects
from buggy_rl.effects.sensing.mounting import SensorLeverArm, SensorYaw
from buggy_rl.simulators import make_engine
from tests.effects.faults import batched, follow, over, start, step

SENSING = {
    "sensor_latency": {"dead_time": 0.043},
    "sensor_lag": {"time_constant": 0.05},
    "sensor_yaw": {"angle": 0.1},
    "sensor_lever_arm": {"x": 0.06, "y": -0.03},
    "heading_drift": {"rate": 0.2},
    "pose_scale": {"ratio": 0.9},
    "speed_scale": {"ratio": 1.1},
    "gyro_bias": {"bias": -0.2},
}
EXACT = ("sensor_yaw", "sensor_lever_arm", "pose_scale", "speed_scale", "gyro_bias")


def steered(steps=80):
    time = torch.arange(steps) * 0.01
    return torch.stack([-0.2 + 0 * time, 0.6 * torch.sin(5 * time)], -1)


def driven(effects, engine="single_track", actions=None, velocity=(1.5, 0.0, 0.0)):
    env = over(effects, engine)
    return follow(env, start(env, velocity), steered() if actions is None else actions)


def straight(effects, speed=2.0, steps=20):
    return driven(effects, "hold", torch.tensor([[-1.0, 0.0]]).expand(steps, 2), (speed, 0.0, 0.0))


@pytest.mark.parametrize("name", SENSING)
def test_no_sensor_moves_the_car(name):
    bare = driven([])
    states = driven([make_effect(name, SENSING[name])])
    for key in (keys.POSE, keys.VELOCITY):
        assert torch.equal(states[key], bare[key])


def test_latency_shows_where_the_car_was():
    # 2 m/s for 43 ms: 86 mm behind, at once, because a car seen in motion came from somewhere.
    states = straight([make_effect("sensor_latency", {"dead_time": 0.043})])
    behind = states[keys.POSE][:, 0] - states[keys.MEASURED_POSE][:, 0]
    torch.testing.assert_close(behind, torch.full((20,), 0.086), atol=1e-5, rtol=0)


def test_latency_shows_the_very_rows_of_before_in_a_turn():
    states = driven([make_effect("sensor_latency", {"dead_time": 0.05})])
    for key, measured in ((keys.POSE, keys.MEASURED_POSE), (keys.VELOCITY, keys.MEASURED_VELOCITY)):
        torch.testing.assert_close(states[measured][5:], states[key][:-5], atol=1e-6, rtol=0)


def test_latency_at_a_reset_looks_back_along_the_arc():
    # On a circle of radius 1 m at 1 m/s, 0.3 s ago the car was 0.3 rad back on it: at
    # (-sin 0.3, 1 - cos 0.3), heading -0.3 rad.
    env = over([make_effect("sensor_latency", {"dead_time": 0.3})])
    state = start(env, (1.0, 0.0, 1.0))
    expected = torch.tensor([-math.sin(0.3), 1 - math.cos(0.3), -0.3])
    torch.testing.assert_close(state[keys.MEASURED_POSE], expected, atol=1e-4, rtol=0)


def test_latency_sees_the_motion_that_was_imposed():
    env = over([make_effect("sensor_latency", {"dead_time": 0.02})])
    state = start(env)
    for row in range(4):  # a car that is put down 1 m further each step
        state = state.clone().set(keys.POSE, torch.tensor([float(row), 0.0, 0.0]))
        state = step(env, state)
    # The last step went from x = 3, where a standing car stays; two rows before its end is x = 2.
    assert float(state[keys.MEASURED_POSE][0]) == 2.0


def test_lag_trails_by_its_time_constant_at_a_steady_speed():
    states = straight([make_effect("sensor_lag", {"time_constant": 0.05})])
    behind = states[keys.POSE][:, 0] - states[keys.MEASURED_POSE][:, 0]
    torch.testing.assert_close(behind, torch.full((20,), 0.1), atol=1e-5, rtol=0)


def test_lag_shows_63_percent_of_a_change_of_speed_after_its_time_constant():
    # A speed that jumps within one period, taken as a ramp over it: half a period late.
    env = over([make_effect("sensor_lag", {"time_constant": 0.1})])
    state = start(env, (1.0, 0.0, 0.0))
    state = state.clone().set(keys.VELOCITY, torch.tensor([2.0, 0.0, 0.0]))
    shown = follow(env, state, torch.tensor([[-1.0, 0.0]]).expand(12, 2))[keys.MEASURED_VELOCITY]
    share = shown[:, 0] - 1
    # 1 - exp(-t / T) from the middle of that period: after ten periods t = 0.095 s.
    assert math.isclose(float(share[9]), 1 - math.exp(-0.95), abs_tol=2e-3)


def test_a_lever_arm_on_a_circle_shows_a_circle_of_another_radius():
    # Radius 1 m to the left at 1 m/s; 0.1 m to the left the radius is 0.9 m and so is the speed.
    env = over([make_effect("sensor_lever_arm", {"x": 0.0, "y": 0.1})])
    states = follow(env, start(env, (1.0, 0.0, 1.0)), torch.zeros(150, 2))
    centre = torch.tensor([0.0, 1.0])
    radius = (states[keys.MEASURED_POSE][:, :2] - centre).norm(dim=-1)
    torch.testing.assert_close(radius, torch.full((150,), 0.9), atol=1e-4, rtol=0)
    velocity = torch.tensor([0.9, 0.0, 1.0]).expand(150, 3)
    torch.testing.assert_close(states[keys.MEASURED_VELOCITY], velocity, atol=1e-5, rtol=0)


def test_a_sensor_ahead_sees_the_nose_swing():
    env = over([make_effect("sensor_lever_arm", {"x": 0.1, "y": 0.0})])
    state = step(env, start(env, (1.0, 0.0, 2.0)))
    torch.testing.assert_close(state[keys.MEASURED_VELOCITY], torch.tensor([1.0, 0.2, 2.0]))


def test_a_sensor_that_looks_left_sees_a_straight_car_drift_right():
    env = over([make_effect("sensor_yaw", {"angle": 0.1})])
    state = step(env, start(env, (2.0, 0.0, 0.5)))
    expected = torch.tensor([2 * math.cos(0.1), -2 * math.sin(0.1), 0.5])
    torch.testing.assert_close(state[keys.MEASURED_VELOCITY], expected)
    turned = state[keys.MEASURED_POSE] - state[keys.POSE]
    torch.testing.assert_close(turned, torch.tensor([0.0, 0.0, 0.1]), atol=1e-6, rtol=0)


def test_scale_and_bias_change_what_they_say():
    effects = make_effects({"speed_scale": {"ratio": 1.1}, "gyro_bias": {"bias": 0.2}})
    env = over(effects)
    state = step(env, start(env, (2.0, 0.5, 1.0)))
    torch.testing.assert_close(state[keys.MEASURED_VELOCITY], torch.tensor([2.2, 0.55, 1.2]))
    assert torch.equal(state[keys.MEASURED_POSE], state[keys.POSE])


def test_the_scale_of_a_map_is_one_of_way_and_speed_alike():
    env = over([make_effect("pose_scale", {"ratio": 0.9})])
    state = step(env, start(env, (2.0, 0.5, 1.0), (10.0, -4.0, 0.3)))
    factor = torch.tensor([0.9, 0.9, 1.0])
    torch.testing.assert_close(state[keys.MEASURED_VELOCITY], factor * state[keys.VELOCITY])
    torch.testing.assert_close(state[keys.MEASURED_POSE], factor * state[keys.POSE])


def test_a_drifting_heading_bends_a_straight_path_into_a_circle():
    # 2 m/s straight ahead and 0.5 rad/s of drift: a circle of 4 m, from where the drive began.
    env = over([make_effect("heading_drift", {"rate": 0.5})])
    states = follow(env, start(env, (2.0, 0.0, 0.0), (3.0, 1.0, 0.0)), torch.zeros(100, 2))
    angle = 0.005 * torch.arange(1, 101)
    expected = torch.stack([3 + 4 * angle.sin(), 1 + 4 * (1 - angle.cos()), angle], -1)
    torch.testing.assert_close(states[keys.MEASURED_POSE], expected, atol=2e-4, rtol=0)
    torch.testing.assert_close(states[keys.MEASURED_VELOCITY], states[keys.VELOCITY])


def test_a_drift_goes_on_from_a_pose_that_was_imposed():
    env = over([make_effect("heading_drift", {"rate": 0.5})])
    state = start(env)
    for row in range(1, 4):  # a car that is put down 1 m further each step, and stands there
        state = state.clone().set(keys.POSE, torch.tensor([float(row), 0.0, 0.0]))
        state = step(env, state)
    # Put down elsewhere it has not driven there: no way is turned, the heading has drifted.
    expected = torch.tensor([3.0, 0.0, 0.015])
    torch.testing.assert_close(state[keys.MEASURED_POSE], expected, atol=1e-6, rtol=0)


def test_a_drift_behind_other_errors_bends_what_they_show():
    # A camera 0.1 m ahead on a car that turns at 1 rad/s on the spot sees itself go round.
    values = {"sensor_lever_arm": {"x": 0.1, "y": 0.0}, "heading_drift": {"rate": 0.2}}
    env = over(make_effects(values))
    states = follow(env, start(env, (0.0, 0.0, 1.0)), torch.zeros(50, 2))
    arm = make_effects({"sensor_lever_arm": values["sensor_lever_arm"]})
    plain = over(arm)
    bare = follow(plain, start(plain, (0.0, 0.0, 1.0)), torch.zeros(50, 2))
    drift = make_effect("heading_drift", {"rate": 0.2})
    rows = torch.cat([torch.tensor([[0.1, 0.0, 0.0]]), states[keys.MEASURED_POSE]])
    undone, _ = drift.unsensed(rows, torch.zeros(51, 3), 0.01)
    torch.testing.assert_close(undone[1:], bare[keys.MEASURED_POSE], atol=1e-5, rtol=0)


def recovered(name, engine="single_track"):
    """True and recovered pose and velocity [T, 3] of a drive."""
    effect = make_effect(name, SENSING[name])
    states = driven([make_effect(name, SENSING[name])], engine)
    seen = effect.unsensed(states[keys.MEASURED_POSE], states[keys.MEASURED_VELOCITY], 0.01)
    return (states[keys.POSE], states[keys.VELOCITY]), seen


@pytest.mark.parametrize("name", EXACT)
def test_what_a_mounting_does_is_undone_exactly(name):
    truth, seen = recovered(name)
    for real, found in zip(truth, seen, strict=True):
        torch.testing.assert_close(found, real, atol=2e-6, rtol=1e-6)


@pytest.mark.parametrize("name", ["sensor_latency", "sensor_lag"])
def test_what_is_late_is_undone_far_better_than_left(name):
    effect = make_effect(name, SENSING[name])
    states = driven([make_effect(name, SENSING[name])])
    late = states[keys.MEASURED_POSE], states[keys.MEASURED_VELOCITY]
    found = effect.unsensed(*late, 0.01)
    truth = states[keys.POSE], states[keys.VELOCITY]
    inside = slice(5, -5)  # the ends have no rows to look ahead to
    for real, seen, shown in zip(truth, found, late, strict=True):
        missed = (shown - real)[inside].square().mean().sqrt()
        assert (seen - real)[inside].square().mean().sqrt() < 0.1 * missed
        assert (seen - real).isfinite().all()


def test_a_record_may_have_a_value_for_each_car():
    rows = [{"dead_time": 0.0}, {"dead_time": 0.02}, {"dead_time": 0.035}]
    together = batched("sensor_latency", rows)
    pose = torch.rand(3, 30, 3).cumsum(1)
    velocity = torch.rand(3, 30, 3)
    found = together.unsensed(pose, velocity, 0.01)
    assert torch.equal(found[0][0], pose[0])
    for car, row in enumerate(rows):
        alone = make_effect("sensor_latency", row).unsensed(pose[car], velocity[car], 0.01)
        torch.testing.assert_close(found[0][car], alone[0])
        torch.testing.assert_close(found[1][car], alone[1])
    torch.testing.assert_close(found[0][1, :-2], pose[1, 2:])  # 20 ms: two rows ahead


@pytest.mark.parametrize("name", ["steering_lag", "floor_slope"])
def test_what_is_no_sensor_leaves_a_record_alone(name):
    pose, velocity = torch.rand(20, 3), torch.rand(20, 3)
    found = make_effect(name).unsensed(pose, velocity, 0.01)
    assert torch.equal(found[0], pose)
    assert torch.equal(found[1], velocity)


def test_a_short_record_is_undone_as_well_as_it_can_be():
    effect = make_effect("sensor_lag", {"time_constant": 0.1})
    pose = torch.tensor([[0.0, 0.0, 0.0], [0.02, 0.0, 0.0]])  # 2 m/s: 0.2 m ahead
    found, _ = effect.unsensed(pose, torch.zeros(2, 3), 0.01)
    torch.testing.assert_close(found[:, 0], torch.tensor([0.2, 0.22]))
    alone, _ = effect.unsensed(pose[:1], torch.zeros(1, 3), 0.01)
    assert torch.equal(alone, pose[:1])


def test_latency_must_stand_next_to_the_engine():
    late = make_effect("sensor_latency", {"dead_time": 0.05})
    env = over([make_effect("gyro_bias", {"bias": 0.1}), late], make_engine("hold"))
    with pytest.raises(ValueError, match="comes too late"):
        _ = env.output_spec


def test_an_effect_that_stands_twice_is_refused():
    twice = [make_effect("sensor_lag", {"time_constant": 0.05}) for _ in range(2)]
    env = over(twice, make_engine("hold"))
    with pytest.raises(ValueError, match="is in the stack twice"):
        _ = env.output_spec


def test_a_part_of_the_cars_can_be_late():
    rows = [{"time_constant": 0.0}, {"time_constant": 0.05}]
    env = over([batched("sensor_lag", rows)], "hold", (2,))
    velocity = torch.tensor([[2.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    state = env.reset(
        TensorDict({keys.VELOCITY: velocity, keys.POSE: torch.zeros(2, 3)}, [2]), set_state=True
    )
    behind = (state[keys.POSE] - state[keys.MEASURED_POSE])[:, 0]
    torch.testing.assert_close(behind, torch.tensor([0.0, 0.1]))


@pytest.mark.parametrize(("angle", "side"), [(0.008, "left"), (-0.008, "right")])
def test_half_a_degree_to_the_left_is_said_to_be_left(angle, side):
    assert f"0.46 degrees to the {side}" in SensorYaw.sentence({"angle": angle})


@pytest.mark.parametrize(
    ("x", "y", "said"),
    [
        (0.03, -0.02, "3 cm ahead of and 2 cm right of"),
        (-0.03, 0.02, "3 cm behind and 2 cm left of"),
    ],
)
def test_where_a_sensor_sits_is_said_in_centimetres(x, y, said):
    assert said in SensorLeverArm.sentence({"x": x, "y": y})
