"""What each fault of a foreign plant does to its motion, by amounts worked out by hand.

Where a sound and a faulty car are compared, both begin in one state, so that their own drags are
alike and only the fault is left.
"""

import math
from functools import cache

import numpy as np
import pytest
import torch

from buggy_rl.core import keys
from buggy_rl.proof.plants.faults import EFFECTS, PlantFaults
from buggy_rl.proof.plants.mechanics import MINUTES, patch_grip, push
from tests.proof.plants.drives import (
    FOREIGN,
    MASS,
    STEP,
    WHEELS,
    drive,
    faulty,
    follow,
    gained,
    sound,
    sound_drive,
    start,
    warmed,
)

pytestmark = pytest.mark.slow

foreign = pytest.mark.parametrize("plant", FOREIGN)
FAST = (2.0, 0.0, 0.0)
NO_DRIVE = -1.0


def slowing(plant, effect, speed=2.0, **parameters):
    """By how much more a faulty car slows down when it coasts straight on [m/s^2]."""
    state = start(sound(plant), (speed, 0.0, 0.0))
    cars = sound(plant), faulty(plant, effect, **parameters)
    own, theirs = (gained(car, state, 5, NO_DRIVE) for car in cars)
    return own - theirs


@foreign
@pytest.mark.parametrize("speed", [1.0, 2.5])
def test_rolling_resistance_slows_by_its_deceleration_at_any_speed(plant, speed):
    change = slowing(plant, "rolling_resistance", speed, deceleration=0.4)
    assert change == pytest.approx(0.4, rel=0.05)


@foreign
def test_viscous_drag_slows_by_its_rate_times_the_speed(plant):
    # 0.3 1/s at 2 m/s.
    assert slowing(plant, "viscous_drag", rate=0.3) == pytest.approx(0.6, rel=0.06)


@foreign
def test_aerodynamic_drag_slows_with_the_square_of_the_speed(plant):
    # 0.1 1/m at 2 m/s and at 3 m/s, a little less as they slow down.
    assert slowing(plant, "aerodynamic_drag", 2.0, coefficient=0.1) == pytest.approx(0.4, rel=0.07)
    assert slowing(plant, "aerodynamic_drag", 3.0, coefficient=0.1) == pytest.approx(0.9, rel=0.1)


@foreign
def test_cornering_drag_slows_by_the_square_of_the_lateral_acceleration(plant):
    state = warmed(plant, (60, 0.0, 0.6), velocity=FAST)
    speed, _, yaw_rate = state[keys.VELOCITY][0].tolist()
    car = faulty(plant, "cornering_drag", coefficient=0.05)
    own, theirs = (gained(c, state, 5, 0.0, 0.6) for c in (sound(plant), car))
    assert speed * yaw_rate > 2.0  # [m/s^2], a real turn
    assert own - theirs == pytest.approx(0.05 * (speed * yaw_rate) ** 2, rel=0.2)


@foreign
def test_turned_wheels_drag_by_their_angle_at_any_speed(plant):
    lock = {"mujoco": 0.36, "commonroad": 0.36}[plant]
    for speed in (0.8, 2.0):
        state = warmed(plant, (60, -0.2, 0.5), velocity=(speed, 0.0, 0.0))
        car = faulty(plant, "steering_drag", per_angle=3.0)
        own, theirs = (gained(c, state, 5, -0.2, 0.5) for c in (sound(plant), car))
        assert own - theirs == pytest.approx(3.0 * 0.5 * lock, rel=0.1)


def turned(plant, effect, actions, speed=2.2, **parameters):
    """Velocity [3] of a sound and of a faulty car at the end of a drive, at their sensor."""
    velocity = (speed, 0.0, 0.0)
    own = sound_drive(plant, actions, velocity=velocity)
    theirs = drive(faulty(plant, effect, **parameters), actions, velocity=velocity)
    return [velocities[-1].tolist() for velocities in (own, theirs)]


@foreign
def test_a_linkage_that_gives_way_turns_less_the_faster_the_bend(plant):
    lost = []
    for throttle, speed in ((-0.45, 0.8), (0.0, 2.5)):
        (vx, _, r), (less_vx, _, less_r) = turned(
            plant, "understeer", (100, throttle, 0.3), speed, gradient=0.008
        )
        lost.append(1 - (less_r / less_vx) / (r / vx))
    assert 0 <= lost[0] < 0.12
    assert lost[1] > lost[0] + 0.05


@foreign
def test_softer_tyres_need_a_larger_slip_angle_for_the_same_bend(plant):
    own, theirs = turned(plant, "cornering_stiffness", (100, -0.1, 0.3), ratio=0.6)
    drift = []
    for vx, vy, r in (own, theirs):
        # Rear axle: 0.115 m behind the sensor.
        drift.append((vy - 0.115 * r) / vx / (vx * r))  # rad over m/s^2
    assert drift[1] / drift[0] == pytest.approx(1 / 0.6, rel=0.15)


@foreign
@pytest.mark.parametrize(("effect", "size"), [("torque_steer", 0.01), ("dive_steer", -0.01)])
def test_under_throttle_the_car_pulls_to_the_side_and_coasting_it_does_not(plant, effect, size):
    name = {"torque_steer": "offset", "dive_steer": "angle"}[effect]
    own, right = turned(plant, effect, (40, 0.3, 0.0), 1.5, **{name: size})
    _, left = turned(plant, effect, (40, 0.3, 0.0), 1.5, **{name: -size})
    assert right[2] < own[2] - 0.05
    assert left[2] - own[2] == pytest.approx(own[2] - right[2], rel=0.15)
    if effect == "torque_steer":
        own, coasting = turned(plant, effect, (40, NO_DRIVE, 0.0), 1.5, **{name: size})
        assert coasting[2] == pytest.approx(own[2], abs=0.01)


@foreign
def test_a_stiff_differential_widens_every_bend_alike(plant):
    # Its moment and the tyres' damping both go with r / v.
    lost = []
    for throttle, speed in ((-0.4, 1.0), (0.0, 2.5)):
        (vx, _, r), (less_vx, _, less_r) = turned(
            plant, "stiff_differential", (80, throttle, 0.3), speed, coupling=0.8
        )
        lost.append(1 - (less_r / less_vx) / (r / vx))
    assert lost[0] > 0.1
    assert lost[1] == pytest.approx(lost[0], rel=0.15)


@foreign
@pytest.mark.parametrize(("yaw", "pulled"), [(0.0, 0.3), (math.pi, -0.3), (math.pi / 2, 0.2)])
def test_a_slope_pulls_by_the_compass_on_car_and_turning_wheels(plant, yaw, pulled):
    state = start(sound(plant), FAST, (0.0, 0.0, yaw))
    car = faulty(plant, "floor_slope", along_x=0.3, along_y=0.2)
    own, theirs = (gained(c, state, 5, NO_DRIVE) for c in (sound(plant), car))
    assert theirs - own == pytest.approx(pulled * MASS / (MASS + WHEELS[plant]), rel=0.06)


@foreign
def test_a_car_across_a_slope_drifts_down(plant):
    car = faulty(plant, "floor_slope", along_y=0.4)
    velocity, state = follow(car, start(car, FAST), [(80, 0.0, 0.0)])
    assert state[keys.POSE][0, 1] > 0.01
    # Tyres hold m a sideways by slip angles; these are C = about 7 to 9 per radian of load.
    sideslip = velocity[-1, 1] / velocity[-1, 0]
    assert 0.25 < sideslip * 8 * 9.8 / 0.4 < 4.0


@foreign
def test_wind_pushes_along_by_a_stream_over_the_cars_own_way(plant):
    state = start(sound(plant), FAST)
    car = faulty(plant, "wind", force_x=0.3)
    own, theirs = (gained(c, state, 5, NO_DRIVE) for c in (sound(plant), car))
    # m f (1 + w) = 1.5 k W^2 with k = 0.015 kg/m; then k ((W - v)^2 + v^2) over mass and wheels.
    heavy = MASS + WHEELS[plant]
    wind = math.sqrt(0.3 * heavy / (1.5 * 0.015))
    assert theirs - own == pytest.approx(0.015 * ((wind - 2.0) ** 2 + 2.0**2) / heavy, rel=0.06)


@foreign
def test_side_wind_blows_a_car_off_and_against_it_slows(plant):
    across = faulty(plant, "wind", force_y=0.4)
    _, state = follow(across, start(across, FAST), [(60, 0.0, 0.0)])
    assert state[keys.POSE][0, 1] > 0.01
    assert slowing(plant, "wind", force_x=-0.3) > 0.3 * 2 / 3


def test_the_push_on_a_standing_car_is_the_stated_one_in_the_mean_of_front_and_side():
    faults = PlantFaults({"wind": {"force_x": 0.3, "force_y": 0.0}}, EFFECTS, "test")
    pushed = push(faults, 1.0, MASS, 0.005, 0.08)
    front = pushed(1.0, 0.0, 0.0, 0.0, 0.0)[0]
    side = pushed(0.0, 1.0, 0.0, 0.0, 0.0)[1]  # heading along y the wind comes from its left
    assert (front + abs(side)) / 2 == pytest.approx(0.3)
    assert side == pytest.approx(-2 * front)


@foreign
def test_yaw_damping_takes_its_rate_of_the_yaw_rate(plant):
    state = warmed(plant, (60, 0.0, 0.4), velocity=(1.0, 0.0, 0.0))
    yaw_rate = float(state[keys.VELOCITY][0, 2])
    cars = sound(plant), faulty(plant, "yaw_damping", rate=5.0)
    own, theirs = (follow(c, state, [(1, 0.0, 0.4)])[0][0, 2] for c in cars)
    taken = float(own - theirs) / (5.0 * yaw_rate * STEP)
    # All of it at first; within 10 ms at 1 m/s the tyres bring a good part back.
    assert yaw_rate > 0.5
    assert 0.3 < taken < 1.0


@foreign
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_one_sided_drag_turns_the_car_to_its_side_as_fast_as_stated(plant, side):
    state = start(sound(plant), (3.0, 0.0, 0.0))
    cars = sound(plant), faulty(plant, "one_sided_drag", yaw_acceleration=8.0 * side)
    own, theirs = (follow(c, state, [(3, NO_DRIVE, 0.0)])[0] for c in cars)
    turned = side * float(theirs[0, 2] - own[0, 2]) / (8.0 * STEP)
    assert 0.4 < turned < 1.0  # tyres hold against it
    # Its drag on one side: 0.1 x 8 rad/s^2 x 0.0049 kg m^2 / 77.5 mm over mass and wheels.
    lost = float(own[-1, 0] - theirs[-1, 0]) / (3 * STEP)
    expected = 0.8 * 0.0049 / 0.0775 / (MASS + WHEELS[plant])
    assert lost == pytest.approx(expected, rel=0.35)


@cache
def limit(car, speed=3.0):
    """Lateral acceleration [m/s^2] of the centre of gravity of a car thrown into a turn."""
    vx, vy, yaw_rate = drive(car, (40, -0.3, 1.0), velocity=(speed, 0.0, 0.0)).unbind(-1)
    at_cg = vy - 0.022 * yaw_rate  # the sensor is 22 mm ahead
    return float((at_cg.diff() / STEP + (vx * yaw_rate)[1:])[15:].abs().median())


@foreign
def test_low_grip_lowers_the_limit_and_leaves_small_slips_alone(plant):
    worn = faulty(plant, "tire_grip", grip=0.6)
    assert limit(worn) / limit(sound(plant)) == pytest.approx(0.6, abs=0.08)
    gentle = ((40, NO_DRIVE, 0.1),)
    own, theirs = (drive(c, *gentle, velocity=(1.5, 0.0, 0.0)) for c in (sound(plant), worn))
    assert float(theirs[-1, 2] / own[-1, 2]) == pytest.approx(1.0, abs=0.01)


def test_a_weak_front_axle_understeers_and_a_strong_one_does_not():
    weak = faulty("mujoco", "grip_balance", front_to_rear=0.64)
    assert float(weak._forces._grip[0, 0]) == pytest.approx(0.9 * 0.8, rel=1e-5)
    assert float(weak._forces._grip[2, 0]) == pytest.approx(0.9 / 0.8, rel=1e-5)
    strong = faulty("mujoco", "grip_balance", front_to_rear=1.3)
    assert limit(weak) < 0.9 * limit(sound("mujoco"))
    assert limit(strong) > limit(weak)


@foreign
def test_a_grip_patch_is_felt_on_it_and_nowhere_else(plant):
    away = faulty(plant, "grip_patch", x=15.0, y=0.0, radius=2.0, grip=0.5)
    here = faulty(plant, "grip_patch", x=0.0, y=0.0, radius=10.0, grip=0.6)
    assert limit(away) == limit(sound(plant))
    assert limit(here) == pytest.approx(limit(faulty(plant, "tire_grip", grip=0.6)), rel=0.03)


def test_the_edge_of_a_patch_is_as_wide_as_a_tyres_contact():
    faults = PlantFaults({"grip_patch": {"radius": 1.0, "grip": 0.4}}, EFFECTS, "test")
    places = np.array([0.98, 1.0, 1.02])
    assert patch_grip(faults, places, np.zeros(3)) == pytest.approx([0.4, 0.7, 1.0])


@foreign
def test_a_payload_takes_its_share_of_the_acceleration(plant):
    state = warmed(plant, (30, 0.1, 0.0), velocity=FAST)
    own = gained(sound(plant), state, 3, 0.1)
    theirs = gained(faulty(plant, "payload", mass_ratio=1.4), state, 3, 0.1)
    # One force at first: (m + w) a = (1.4 m + w) a'.
    ratio = (MASS + WHEELS[plant]) / (1.4 * MASS + WHEELS[plant])
    assert own > 0.5
    assert theirs / own == pytest.approx(ratio, rel=0.06)


@foreign
def test_a_payload_that_only_rolls_out_is_slowed_less(plant):
    assert slowing(plant, "payload", mass_ratio=1.4) < -0.1


@cache
def coasting(plant, speed):
    """Forward acceleration [m/s^2] of a sound car without drive."""
    return gained(sound(plant), start(sound(plant), (speed, 0, 0)), 3, NO_DRIVE)


def pulled(car, plant, throttle, speed, steps=3):
    """Force of the motor [N] at a throttle that has long been held."""
    held = warmed(plant, (60, throttle, 0.0), velocity=(speed, 0, 0))
    held[keys.VELOCITY] = torch.tensor([[speed, 0.0, 0.0]])  # wheels are sped up with the car
    return (gained(car, held, steps, throttle) - coasting(plant, speed)) * (MASS + WHEELS[plant])


@foreign
def test_a_power_limit_is_one_of_force_over_speed(plant):
    # 3 W/kg x 1.625 kg / 3 m/s = 1.625 N at the shaft.
    force = pulled(faulty(plant, "motor_power_limit", power_per_mass=3.0), plant, 0.5, 3.0)
    assert force == pytest.approx(1.625, rel=0.1)
    assert pulled(sound(plant), plant, 0.5, 3.0) > 2.0


@foreign
def test_a_lower_top_speed_is_more_back_emf_and_as_much_force_from_rest(plant):
    duty, loss = {"mujoco": ((0.7 - 0.1) / 0.9, 3.5), "commonroad": ((0.7 - 0.15) / 0.85, 0.6)}[
        plant
    ]
    slower = faulty(plant, "top_speed", speed_ratio=0.8)
    missing = pulled(sound(plant), plant, 0.4, 3.0) - pulled(slower, plant, 0.4, 3.0)
    # d c v (1 / 0.8 - 1), less what less wheel slip gives back.
    assert missing == pytest.approx(duty * loss * 3.0 * (1 / 0.8 - 1), rel=0.13)


@foreign
def test_a_throttle_gain_scales_the_motors_force(plant):
    ratio = pulled(faulty(plant, "throttle_gain", gain=0.8), plant, 0.0, 2.0) / pulled(
        sound(plant), plant, 0.0, 2.0
    )
    assert ratio == pytest.approx(0.8, abs=0.03)


@foreign
def test_a_throttle_deadband_takes_its_width_off_the_drive(plant):
    own = {"mujoco": 0.1, "commonroad": 0.15}[plant]
    ratio = pulled(faulty(plant, "throttle_deadband", width=0.08), plant, 0.0, 2.0) / pulled(
        sound(plant), plant, 0.0, 2.0
    )
    assert ratio == pytest.approx((0.5 - own - 0.08) / (0.5 - own), abs=0.03)


@foreign
def test_a_sagging_battery_weakens_the_drive_by_what_was_taken_out(plant):
    state = warmed(plant, (40, 0.0, 0.0), velocity=FAST)
    car = faulty(plant, "battery_sag", loss_per_minute=0.4)
    state = car.reset(state.select(keys.POSE, keys.VELOCITY), set_state=True).update(state)
    fresh = gained(car, state.clone(), 3, 0.0)
    state["plant_memory"][..., MINUTES] = 1.0  # of typical driving
    empty = gained(car, state.clone(), 3, 0.0)
    coasting = gained(sound(plant), start(sound(plant), FAST), 3, NO_DRIVE)
    assert (empty - coasting) / (fresh - coasting) == pytest.approx(0.6, abs=0.05)


@foreign
@pytest.mark.parametrize("offset", [0.1, -0.2])
def test_offsets_add_to_the_commands(plant, offset):
    for effect, moved in (("throttle_offset", (offset, 0.0)), ("steering_offset", (0.0, offset))):
        theirs = drive(faulty(plant, effect, offset=offset), (30, 0.2, 0.3), velocity=FAST)
        own = drive(sound(plant), (30, 0.2 + moved[0], 0.3 + moved[1]), velocity=FAST)
        assert torch.allclose(theirs, own, atol=1e-5)


@foreign
@pytest.mark.parametrize("effect", ["throttle_dead_time", "steering_dead_time"])
def test_a_dead_time_shifts_the_answer_by_itself(plant, effect):
    theirs = drive(faulty(plant, effect, dead_time=0.05), (30, 0.3, 0.5), velocity=FAST)
    before, after = {
        "throttle_dead_time": ((5, -1.0, 0.5), (25, 0.3, 0.5)),
        "steering_dead_time": ((5, 0.3, 0.0), (25, 0.3, 0.5)),
    }[effect]
    assert torch.allclose(theirs, drive(sound(plant), before, after, velocity=FAST), atol=1e-5)
    # Between two periods the answer is between theirs.
    between = drive(faulty(plant, effect, dead_time=0.045), (30, 0.3, 0.5), velocity=FAST)
    assert 0 < float((between - theirs).abs().max()) < 0.3


def curvature(velocity):
    """Of the path [1/m], which unlike the yaw rate does not grow with the speed."""
    return velocity[:, 2] / velocity[:, 0]


@foreign
def test_a_steering_lag_delays_the_turn_by_its_time_constant(plant):
    turn = ((90, -0.2, 0.2),)
    own, theirs = (
        curvature(drive(car, *turn, velocity=(1.5, 0.0, 0.0)))
        for car in (sound(plant), faulty(plant, "steering_lag", time_constant=0.1))
    )
    # The area between both answers is the lag times the height.
    assert float((own - theirs).sum()) * STEP / float(own[-1]) == pytest.approx(0.1, rel=0.1)


@foreign
def test_a_throttle_lag_delays_the_drive_by_its_time_constant(plant):
    own, theirs = (
        drive(car, (80, -0.2, 0.0), velocity=(1.0, 0.0, 0.0))[:, 0]
        for car in (sound(plant), faulty(plant, "throttle_lag", time_constant=0.1))
    )
    # The force comes late; only above the deadband, so that more than 0.1 s of it is missing.
    coasting = gained(sound(plant), start(sound(plant), (1.0, 0, 0)), 3, NO_DRIVE)
    height = gained(sound(plant), warmed(plant, (40, -0.2, 0.0), velocity=(1, 0, 0)), 3, -0.2)
    late = float(own[60] - theirs[60]) / (height - coasting)
    assert 0.08 < late < 0.2


def ramp_delay(way, rate, lag):
    """Mean delay [s] by a rate limit of a lagged step, added up in steps of 0.1 ms."""
    times = np.arange(0.0, 1.0, 1e-4)
    asked = way * (1.0 - np.exp(-times / max(lag, 1e-9)))
    followed, area = 0.0, 0.0
    for value in asked:
        followed += min(value - followed, rate * 1e-4)
        area += (value - followed) * 1e-4
    return area / way


@foreign
def test_a_rate_limit_takes_its_time_from_lock_to_lock(plant):
    car = faulty(plant, "steering_rate_limit", rate=4.0)
    state = warmed(plant, (40, -0.2, -0.6), velocity=(1.5, 0.0, 0.0))
    state["plant_memory"][..., 1] = -0.6
    own, theirs = (curvature(follow(c, state, [(90, -0.2, 0.6)])[0]) for c in (sound(plant), car))
    late = float((own - theirs).sum()) * STEP / float(own[-1] - own[0])
    # A ramp over 1.2 of command at 4 1/s is late by half of it, 0.15 s; behind MuJoCo's own lag
    # of T = 0.06 s the limit lets through what is slower, from where 1.2 / T exp(-t / T) < 4 on.
    own_lag = {"mujoco": 0.06, "commonroad": 0.0}[plant]
    assert late == pytest.approx(ramp_delay(1.2, 4.0, own_lag), rel=0.12)


@foreign
def test_play_leaves_the_wheels_turned(plant):
    played = faulty(plant, "steering_backlash", width=0.2)
    theirs = drive(played, (40, -0.2, 0.5), (40, -0.2, 0.0), velocity=(1.5, 0.0, 0.0))
    own = drive(sound(plant), (40, -0.2, 0.4), (40, -0.2, 0.1), velocity=(1.5, 0.0, 0.0))
    assert float(own[-1, 2]) > 0.2
    assert float(theirs[-1, 2]) == pytest.approx(float(own[-1, 2]), rel=0.02)


@foreign
@pytest.mark.parametrize(
    ("effect", "parameters", "left", "right"),
    [
        ("steering_gain", {"gain": 0.8}, 0.4, -0.4),
        # sqrt(0.64) = 0.8: 0.5 x 0.8 and -0.5 / 0.8.
        ("steering_asymmetry", {"left_to_right": 0.64}, 0.4, -0.625),
    ],
)
def test_gain_and_asymmetry_turn_the_wheels_as_another_command_would(
    plant, effect, parameters, left, right
):
    car = faulty(plant, effect, **parameters)
    for asked, acting in ((0.5, left), (-0.5, right)):
        theirs = drive(car, (40, -0.1, asked), velocity=FAST)
        own = drive(sound(plant), (40, -0.1, acting), velocity=FAST)
        assert torch.allclose(theirs, own, atol=2e-3)
