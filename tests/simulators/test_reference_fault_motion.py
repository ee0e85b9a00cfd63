"""What faults of wheels, tyres, body and floor do to the motion: sign, size, and where nothing."""

import math

import numpy as np
import pytest
import torch

from buggy_rl.core import keys
from buggy_rl.core.vehicle import GRAVITY
from tests.simulators.reference_drives import held, start
from tests.simulators.reference_scenes import TURNING, Scenes, cars, velocities

SCENES = Scenes()


@pytest.fixture(scope="module")
def driven():
    return SCENES.driven()


def slowing(vx, speed):
    """Deceleration [m/s^2] of each coasting car [T, n] at one and the same speed."""
    loss, mean = -vx.diff(dim=0) / 0.01, 0.5 * (vx[1:] + vx[:-1])
    settled = slice(10, None)  # tyres and springs need a moment
    assert (mean[-1] < speed).all()
    assert (mean[10] > speed).all()
    pairs = zip(mean[settled].T.numpy(), loss[settled].T.numpy(), strict=True)
    return [float(np.interp(-speed, -m, a)) for m, a in pairs]


REST = (0.0, 0.0, 0.0)
COAST = held(-1.0, 0.0, 0.6)

# What slows and pushes.

ROLL = (2.6, 0.0, 0.0)
SLOWED = {  # at 2.35 m/s [m/s^2]
    "rolling_resistance.deceleration": (0.3, 0.3),
    "viscous_drag.rate": (0.2, 0.2 * 2.35),
    "aerodynamic_drag.coefficient": (0.1, 0.1 * 2.35**2),
}
for _name, (_value, _) in SLOWED.items():
    SCENES.add(_name, _name, (0.0, _value), ROLL, COAST)


@pytest.mark.parametrize("name", SLOWED)
def test_coasting_cars_lose_the_stated_deceleration_in_addition(driven, name):
    plain, slowed = slowing(velocities(driven(name))[0], 2.35)
    assert slowed - plain == pytest.approx(SLOWED[name][1], rel=0.05)


SCENES.add("stop", "rolling_resistance.deceleration", (1.0,), (0.5, 0, 0), held(-1, 0, 1.0))


def test_rolling_resistance_stops_a_car_for_good(driven):
    vx, _, _ = velocities(driven("stop"))
    assert vx.min() > -0.03  # the carcass springs back
    assert vx[-20:].abs().max() < 1e-3


TURN = held(-1.0, 0.5, 0.6)
SCENES.add("straight", "cornering_drag.coefficient", (0.0, 0.06), ROLL, COAST)
SCENES.add("turn", "cornering_drag.coefficient", (0.0, 0.06), (2.2, 0.0, 2.2), TURN)


def test_cornering_drag_is_felt_in_turns_only(driven):
    vx, _, _ = velocities(driven("straight"))
    torch.testing.assert_close(vx[:, 0], vx[:, 1], atol=1e-3, rtol=0)
    vx, _, yaw_rate = velocities(driven("turn"))
    plain, slowed = slowing(vx, 1.7)
    side = float(np.interp(-1.7, -vx[:, 1].numpy(), (vx * yaw_rate)[:, 1].numpy()))
    assert side > 2.0
    assert slowed - plain == pytest.approx(0.06 * side**2, rel=0.25)  # the turns differ a little


SCENES.add("joints", "steering_drag.per_angle", (0.0, 3.0), (1.2, 0.0, 0.0), held(-1.0, 0.8, 0.6))
SCENES.add("straight joints", "steering_drag.per_angle", (0.0, 3.0), ROLL, COAST)


def test_turned_wheels_drag_by_their_angle(driven):
    plain, slowed = slowing(velocities(driven("straight joints"))[0], 2.35)
    assert slowed == pytest.approx(plain, abs=1e-3)
    # 0.8 of a lock of 0.36 rad: 0.288 rad.
    plain, slowed = slowing(velocities(driven("joints"))[0], 0.85)
    assert slowed - plain == pytest.approx(3.0 * 0.288, rel=0.1)


AROUND = [0.0, 0.0, math.pi, math.pi / 2]
SCENES.add("slope", "floor_slope.along_x", (0.0, 0.3, 0.3, 0.3), ROLL, COAST, AROUND)


def test_a_slope_pulls_down_hill_whatever_way_the_car_heads(driven):
    vx, vy, _ = velocities(driven("slope"))
    plain, down, up, across = slowing(vx, 2.35)
    # Gravity moves the wheels' inertia too: 0.3 / 1.1176 = 0.268.
    assert plain - down == pytest.approx(0.3 / TURNING, rel=0.05)
    assert up - plain == pytest.approx(0.3 / TURNING, rel=0.05)
    assert across == pytest.approx(plain, abs=0.03)
    assert vy[10, 3] < vy[10, 0] - 0.003  # world x is to the right of a car that heads along y


ASTRAY = [0.0, 1.0, -2.5] * 2
STANDING = held(-1, 0, 1.0)
SCENES.add("hill", "floor_slope.along_x", (0.2,) * 3 + (1.5,) * 3, REST, STANDING, ASTRAY)


def test_a_gentle_slope_holds_the_car_and_a_steep_one_takes_it_down_however_it_stands(driven):
    way = driven("hill")[keys.POSE][-1, :, :2]
    assert torch.linalg.vector_norm(way[:3], dim=-1).max() < 2e-3
    assert (way[3:, 0] > 0.02).all()


SCENES.add("wind", "wind.force_x", (0.0, 0.3, 0.3), ROLL, COAST, [0.0, 0.0, math.pi])


def test_wind_is_felt_by_its_speed_over_the_car(driven):
    air = cars("wind.force_x", 0.0, 0.3).car.surroundings.wind[:, 0].tolist()
    # m f = c W^2 with the mean of front and side, c = 0.0126 * 1.4: W = 5.56 m/s.
    wind = math.sqrt(1.625 * TURNING * 0.3 / (0.0126 * 1.4))
    assert air == pytest.approx([0.0, wind], rel=1e-3)
    plain, behind, against = slowing(velocities(driven("wind"))[0], 2.35)
    # The air's push with what it does at this speed anyway taken off: c ((W -+ v)^2 +- v^2) / m.
    front, v = 0.0126 / (1.625 * TURNING), 2.35
    assert plain - behind == pytest.approx(front * ((wind - v) ** 2 + v**2), rel=0.05)
    assert against - plain == pytest.approx(front * ((wind + v) ** 2 - v**2), rel=0.05)


SCENES.add("bent", "one_sided_drag.yaw_acceleration", (0.0, 12.0, -12.0), ROLL, COAST)
SCENES.add("bent at rest", "one_sided_drag.yaw_acceleration", (12.0,), REST, COAST)


def test_a_bent_axle_turns_the_car_to_its_side_and_slows_it_a_little(driven):
    vx, _, yaw_rate = velocities(driven("bent"))
    assert yaw_rate[:, 0].abs().max() < 1e-4
    assert yaw_rate[20:, 1].min() > 0.02
    torch.testing.assert_close(yaw_rate[:, 1], -yaw_rate[:, 2], atol=2e-3, rtol=0)
    plain, left, right = slowing(vx, 2.35)
    # A tenth of the moment 0.0049 * 12 is a wheel's friction at 0.0775 m: 0.0759 N on 1.816 kg.
    assert left - plain == pytest.approx(0.0418, rel=0.3)
    assert left == pytest.approx(right, abs=2e-3)
    assert torch.stack(velocities(driven("bent at rest"))).abs().max() < 1e-6


GO = held(0.6, 0.0, 0.5)
SCENES.add("pull", "torque_steer.offset", (0.0, 0.01, -0.01), (1.0, 0.0, 0.0), GO)
SCENES.add("no pull", "torque_steer.offset", (0.0, 0.01), ROLL, COAST)


def test_a_motor_that_pushes_on_the_left_turns_the_car_to_the_right_and_does_nothing_at_rest(
    driven,
):
    _, _, yaw_rate = velocities(driven("pull"))
    plain, right, left = yaw_rate[-1].tolist()
    assert right < plain - 0.05
    assert left - plain == pytest.approx(plain - right, rel=0.15)
    _, _, yaw_rate = velocities(driven("no pull"))
    torch.testing.assert_close(yaw_rate[:, 0], yaw_rate[:, 1], atol=1e-3, rtol=0)


BEND = held(-0.35, 0.6, 0.8)
SCENES.add("locked", "stiff_differential.coupling", (0.0, 0.9), (1.2, 0.0, 0.0), BEND)
SCENES.add("locked ahead", "stiff_differential.coupling", (0.0, 0.9), ROLL, COAST)


def test_a_stiff_differential_resists_a_bend_and_leaves_a_straight_alone(driven):
    vx, _, yaw_rate = velocities(driven("locked"))
    curvature = (yaw_rate / vx)[-1]
    assert curvature[1] < 0.95 * curvature[0]
    _, _, yaw_rate = velocities(driven("locked ahead"))
    torch.testing.assert_close(yaw_rate[:, 0], yaw_rate[:, 1], atol=2e-3, rtol=0)


FAST_BEND = held(-0.2, 0.4, 1.0)
SCENES.add("gives", "understeer.gradient", (0.0, 0.008), (2.2, 0.0, 0.0), FAST_BEND)
SCENES.add("soft", "cornering_stiffness.ratio", (1.0, 0.6), (2.2, 0.0, 0.0), FAST_BEND)
SCENES.add("dives", "dive_steer.angle", (0.0, 0.01), (1.0, 0.0, 0.0), GO)


def test_a_linkage_that_gives_way_loses_its_angle_over_the_lateral_acceleration(driven):
    vx, _, yaw_rate = velocities(driven("gives"))
    speed, rate = vx[-1], yaw_rate[-1]
    lateral = speed * rate
    # L r / v + K ay of both is the steering angle, of one of them less 0.008 ay.
    ackermann = 0.174 * rate / speed
    gradient = (1 / 6.1 - 1 / 9.4) / GRAVITY
    needed = ackermann + gradient * lateral
    assert lateral[1] > 2.0
    assert float(needed[0] - needed[1]) == pytest.approx(0.008 * float(lateral[1]), rel=0.15)


def test_softer_tyres_drift_more_in_the_same_bend(driven):
    vx, vy, yaw_rate = velocities(driven("soft"))
    sideslip = (vy / vx)[-1]
    lateral = (vx * yaw_rate)[-1]
    # The rear slip angle a / (C g) grows by 1 / 0.6 - 1: beta falls by as much.
    more = float(lateral[1]) / (9.4 * GRAVITY) / 0.6 - float(lateral[0]) / (9.4 * GRAVITY)
    turned = 0.115 * (yaw_rate / vx)[-1]  # of the sensor ahead of the rear axle
    fell = (sideslip - turned)[0] - (sideslip - turned)[1]
    assert float(fell) == pytest.approx(more, rel=0.2)


def test_a_squatting_car_steers_to_one_side(driven):
    _, _, yaw_rate = velocities(driven("dives"))
    assert yaw_rate[20:, 1].min() > yaw_rate[20:, 0].max() + 0.02


SCENES.add("scrub", "yaw_damping.rate", (0.0, 6.0), (1.5, 0.0, 0.0), held(-0.3, 0.6, 0.6))


def test_scrubbing_takes_yaw_rate_at_its_rate(driven):
    engine = cars("yaw_damping.rate", 0.0, 6.0)
    car = engine._unpacked(engine.reset(start([[0.0, 0.0, 2.0], [0.0, 0.0, 2.0]]), set_state=True))
    *_, scrub = engine.car.surroundings.push(car, torch.zeros(2, 3))
    assert scrub.tolist() == [0.0, -12.0]
    turn = velocities(driven("scrub"))[2]
    assert turn[20, 1] < 0.98 * turn[20, 0]
    assert turn[-1, 1] < 0.98 * turn[-1, 0]


# Tyres and load.

HARD_OVER = (4.0, 0.0, 2.0), held(0.1, 1.0, 1.0)
SCENES.add("slippery", "tire_grip.grip", (1.0, 0.75), *HARD_OVER)
SCENES.add("gentle", "tire_grip.grip", (1.0, 0.6), (0.8, 0.0, 0.6), held(-0.5, 0.3, 1.0))
SCENES.add("pushing", "grip_balance.front_to_rear", (1.0, 0.7), *HARD_OVER)


def side_acceleration(states):
    """Mean v r [n] [m/s^2] of the second half."""
    vx, _, yaw_rate = velocities(states)
    return (vx * yaw_rate)[len(vx) // 2 :].mean(0)


def test_at_the_limit_lateral_acceleration_is_grip_times_gravity(driven):
    plain, slippery = side_acceleration(driven("slippery")).tolist()
    assert plain > 0.8 * 0.86 * GRAVITY
    assert slippery / plain == pytest.approx(0.75, rel=0.03)


def test_grip_does_not_matter_below_the_limit(driven):
    plain, slippery = side_acceleration(driven("gentle")).tolist()
    assert plain < 1.0
    assert slippery / plain == pytest.approx(1.0, abs=0.03)


def test_less_grip_in_front_makes_the_car_run_wide_and_the_whole_stays(driven):
    tyres = cars("grip_balance.front_to_rear", 1.0, 0.7).car.tyres
    front, rear = tyres.grip[0], tyres.grip[2]
    assert float(front[1] / rear[1]) == pytest.approx(0.7)
    assert float(front[1] * rear[1]) == pytest.approx(0.86**2)
    plain, wide = side_acceleration(driven("pushing")).tolist()
    assert wide < 0.9 * plain


def test_a_patch_acts_on_the_wheels_that_stand_on_it_and_nowhere_else():
    more = {"grip_patch.x": 1.0, "grip_patch.y": 0.5, "grip_patch.radius": 0.5}
    engine = cars("grip_patch.grip", 1.0, 0.4, **more)
    car = engine._unpacked(engine.reset())
    place = engine.car.surroundings.grip
    # Its edge touches y = 0 at x = 1; from the sensor the wheels are 59 mm ahead and 115 mm behind,
    # 77.5 mm to each side.
    along = torch.tensor([[1.0, 0.0, 0.0]]).expand(2, 3)
    assert place(car, along)[:, 1].tolist() == pytest.approx([0.4, 1.0, 0.4, 1.0])
    into = torch.tensor([[1.0, 0.0, math.pi / 2]]).expand(2, 3)
    assert place(car, into)[:, 1].tolist() == pytest.approx([0.4, 0.4, 1.0, 1.0])
    assert (place(car, along)[:, 0] == 1).all()


SCENES.add(
    "patch ahead",
    "grip_patch.grip",
    (1.0, 0.3),
    (2.5, 0.0, 0.0),
    held(0.0, 0.1, 0.8),
    **{"grip_patch.x": 2.0, "grip_patch.y": 0.0, "grip_patch.radius": 0.8},
)


def test_a_patch_ahead_is_not_felt_before_a_wheel_is_on_it(driven):
    states = driven("patch ahead")
    front_axle = states[keys.POSE][:, 0, 0] + 0.059
    outside = int((front_axle < 1.19).sum()) - 1
    assert outside > 20
    vy = states[keys.VELOCITY][..., 1]
    assert torch.equal(vy[:outside, 0], vy[:outside, 1])
    assert (vy[outside:, 0] - vy[outside:, 1]).abs().max() > 1e-3


def test_a_payload_is_mass_load_and_inertia():
    chassis = cars("payload.mass_ratio", 1.0, 1.4).car.chassis
    assert chassis.mass.tolist() == pytest.approx([1.625, 2.275])
    assert chassis.static_load.sum(0).tolist() == pytest.approx([1.625 * GRAVITY, 2.275 * GRAVITY])
    # 0.65 kg with a radius of gyration of 0.04 m: 0.0049 + 0.00104
    assert float(chassis.yaw_inertia[1]) == pytest.approx(0.00594, rel=1e-4)
    # It stands at 80 mm: (45 + 0.4 * 80) / 1.4 = 55 mm for the whole.
    lean = torch.tensor([[0.0, 0.0], [1.0, 1.0]])
    shift = (chassis.loads(lean, torch.zeros(2, 2))[[1, 3]] - chassis.static_load[[1, 3]]).sum(0)
    assert shift.tolist() == pytest.approx([1.625 * 0.045 / 0.155, 2.275 * 0.055 / 0.155], rel=1e-4)


SCENES.add("laden", "payload.mass_ratio", (1.0, 1.4), REST, held(-0.1, 0, 0.6))


def test_a_payload_makes_the_car_slower_off_the_line_without_spinning_it(driven):
    vx = velocities(driven("laden"))[0][-1]
    assert vx[1] < 0.85 * vx[0]
