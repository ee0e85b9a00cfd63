import math

import pytest
import torch

from buggy_rl.core.vehicle import GRAVITY
from buggy_rl.simulators.reference.chassis import Chassis
from buggy_rl.simulators.reference.drivetrain import Drivetrain, stopped
from buggy_rl.simulators.reference.faults import Faults
from buggy_rl.simulators.reference.parameters import DIMENSIONS, PARAMETERS
from buggy_rl.simulators.reference.steering import SteeringServo
from buggy_rl.simulators.reference.tyres import Tyres


def values(**changed):
    return {p.name: torch.tensor([float(changed.get(p.name, p.value))]) for p in PARAMETERS}


def chassis(**changed):
    return Chassis(values(**changed), DIMENSIONS)


def tyres(**changed):
    return Tyres(values(**changed), chassis(**changed).static_load)


def drivetrain(**changed):
    return Drivetrain(values(**changed), DIMENSIONS.wheel_radius, chassis(**changed))


def steering(**changed):
    return SteeringServo(values(**changed), DIMENSIONS.track_width, DIMENSIONS.wheelbase)


def brush_force(slip, load, friction):
    return tyres().force(slip, load, tyres().strain(slip, friction))


def test_no_tyre_pulls_harder_than_friction_times_load():
    draw = torch.Generator().manual_seed(0)
    slip = torch.randn(2, 4, 1000, generator=draw) * 0.5
    load = torch.rand(4, 1000, generator=draw) * 12
    friction = tyres().friction(load, slip * 3)
    force = brush_force(slip, load, friction)
    size = torch.linalg.vector_norm(force, dim=0)
    assert (size <= friction * load * (1 + 1e-5)).all()
    assert (size > 0.999 * friction * load).float().mean() > 0.3  # the bound is reached


def test_small_slip_makes_force_by_stiffness_along_the_slip():
    load, small = torch.full((4, 1), 4.0), 1e-4
    for direction, expected in ((0, (13.0, 13.0)), (1, (6.1, 9.4))):
        slip = torch.zeros(2, 4, 1)
        slip[direction] = small
        force = brush_force(slip, load, torch.full((4, 1), 0.8))
        # F = c F_z s, less a share of c s / (3 mu), here below 0.2 %
        assert force[direction, 0] / (4.0 * small) == pytest.approx(expected[0], rel=3e-3)
        assert force[direction, 2] / (4.0 * small) == pytest.approx(expected[1], rel=3e-3)
        assert (force[1 - direction] == 0).all()


def test_half_slid_contact_holds_seven_eighths_of_the_friction():
    # z = c s / (3 mu) = 0.5: F = mu F_z (1 - 0.5^3); rear tyre, 3 * 0.8 * 0.5 / 9.4 = 0.12766.
    slip = torch.zeros(2, 4, 1)
    slip[1] = 1.2 / 9.4
    force = brush_force(slip, torch.full((4, 1), 4.0), torch.full((4, 1), 0.8))
    assert float(force[1, 2]) == pytest.approx(0.8 * 4.0 * 0.875, rel=1e-5)


def test_driving_force_takes_from_lateral_force():
    slip = torch.zeros(2, 4, 2)
    slip[1] = 0.15
    slip[0, :, 1] = 0.3
    force = brush_force(slip, torch.full((4, 2), 4.0), torch.full((4, 2), 0.8))
    assert (force[1, :, 1] < 0.5 * force[1, :, 0]).all()


def test_friction_falls_with_load_and_with_sliding():
    load = chassis().static_load * torch.tensor([1.0, 2.0, 1.0])
    sliding = torch.zeros(2, 4, 3)
    sliding[0, :, 2] = 2.0
    still, loaded, slid = tyres().friction(load, sliding)[2].tolist()
    assert still == pytest.approx(0.86, rel=1e-4)
    assert loaded == pytest.approx(0.86 / 1.08, rel=1e-4)
    assert slid == pytest.approx(0.86 * (1 - 0.15 / 2), rel=1e-4)  # half the loss at 2 m/s


def test_less_grip_loses_more_friction_by_sliding():
    # At 0.6 of the grip the loss by sliding is 0.15 + 0.15 (1 - 0.6) = 0.21, half of it at 2 m/s.
    load, sliding = chassis().static_load * torch.ones(2), torch.zeros(2, 4, 2)
    sliding[1, :, 1] = 2.0
    faults = Faults({"tire_grip.grip": torch.tensor([0.6])}, torch.zeros(1))
    worn = Tyres(values(), chassis().static_load, faults)
    still, slid = worn.friction(load, sliding)[2].tolist()
    assert still == pytest.approx(0.86 * 0.6, rel=1e-4)
    assert slid == pytest.approx(0.86 * 0.6 * (1 - 0.21 / 2), rel=1e-4)


@pytest.mark.parametrize("speed", [0.5, 1.0, 4.0])
def test_a_tyre_builds_up_its_force_over_distance_not_over_time(speed):
    law, dt = tyres(carcass_damping=0.0), 1e-4
    slip_speed = torch.zeros(2, 4, 1)
    slip_speed[1] = 0.1 * speed
    transport = law.transport_speed(
        torch.full((4, 1), speed), slip_speed[1], torch.full((4, 1), speed)
    )
    slip, steps = torch.zeros(2, 4, 1), 0
    steady = slip_speed[1] / transport
    while slip[1, 0] < (1 - math.exp(-1)) * steady[0]:
        slip, _ = law.relaxed(slip, slip_speed, transport, dt)
        steps += 1
    assert steps * dt * speed == pytest.approx(0.025, rel=0.03)


def test_a_standing_tyre_is_a_spring():
    law, dt = tyres(), 1e-3
    push = torch.zeros(2, 4, 1)
    push[1] = 0.01  # [m/s] for 0.1 s: 1 mm over 25 mm of relaxation length
    slip, still = torch.zeros(2, 4, 1), torch.zeros(4, 1)
    for _ in range(100):
        slip, _ = law.relaxed(slip, push, law.transport_speed(still, push[1], still), dt)
    assert float(slip[1, 0]) == pytest.approx(0.001 / 0.025, rel=0.15)


def test_loads_carry_the_weight_and_shift_against_the_acceleration():
    body = chassis()
    lean = torch.tensor([[0.0, 3.0, -3.0, 0.0], [0.0, 0.0, 0.0, 3.0]])  # (2, 4): four cars
    load = body.loads(lean, torch.zeros(2, 4))
    weight = 1.625 * GRAVITY
    torch.testing.assert_close(load.sum(0), torch.full((4,), weight))
    front, left = load[:2].sum(0), load[0] + load[2]
    assert front[0] == pytest.approx(weight * 0.093 / 0.174, rel=1e-5)
    # Accelerating with 3 m/s^2 takes m a h / L = 1.625 * 3 * 0.045 / 0.174 = 1.261 N off the front.
    assert front[0] - front[1] == pytest.approx(1.261, rel=1e-3)
    assert front[2] - front[0] == pytest.approx(1.261, rel=1e-3)
    # Turning left with 3 m/s^2 takes m a h / t = 1.625 * 3 * 0.045 / 0.155 = 1.415 N off the left.
    assert left[0] - left[3] == pytest.approx(1.415, rel=1e-3)


def test_a_lifted_wheel_does_not_pull_on_the_floor():
    load = chassis().loads(torch.tensor([[0.0], [30.0]]), torch.zeros(2, 1))
    assert (load[[0, 2]] == 0).all()
    assert (load[[1, 3]] > 0).all()


def test_the_body_leans_with_its_own_frequency_and_settles_on_the_acceleration():
    body, dt = chassis(suspension_damping=0.1), 1e-3
    lean, rate, carried = torch.zeros(2, 1), torch.zeros(2, 1), []
    for _ in range(3000):
        lean, rate = body.leaned(lean, rate, torch.tensor([[2.0], [2.0]]), dt)
        carried.append(float(lean[0]))
    first_peak = max(range(300), key=lambda i: carried[i]) * dt
    assert first_peak == pytest.approx(0.5 / 5.0, rel=0.05)  # half a period of 5 Hz
    assert carried[-1] == pytest.approx(2.0, rel=0.01)


def test_a_stalled_motor_draws_the_voltage_over_both_resistances():
    engine, still = drivetrain(), torch.zeros(1)
    # Full throttle: 8.0 V / (0.42 + 0.04) ohm = 17.39 A; half the duty: 4.0 / (0.42 + 0.01).
    full = engine.current(torch.ones(1), still, torch.tensor([8.0]))
    half = engine.current(torch.full((1,), 0.5), still, torch.tensor([8.0]))
    assert float(full) == pytest.approx(17.391, rel=1e-3)
    assert float(half) == pytest.approx(9.302, rel=1e-3)


def test_a_freewheeling_controller_lets_no_braking_current_through():
    speed, off, voltage = torch.tensor([3.0]), torch.zeros(1), torch.tensor([8.0])
    assert float(drivetrain().current(off, speed, voltage)) == 0.0


def test_no_current_flows_at_the_freewheeling_duty():
    engine, speed, voltage = drivetrain(), torch.tensor([3.0]), torch.tensor([8.0])
    duty = engine.freewheeling_duty(speed, voltage)
    assert float(engine.current(duty, speed, voltage)) == pytest.approx(0.0, abs=1e-5)
    assert float(engine.current(duty * 1.01, speed, voltage)) > 0.01


def test_throttle_inside_the_deadband_asks_for_nothing():
    throttle = torch.tensor([-1.0, -0.69, -0.68, -0.26, 1.0])  # drive 0.16 is throttle -0.68
    duty = drivetrain().target_duty(throttle).tolist()
    assert duty == pytest.approx([0.0, 0.0, 0.0, 0.25, 1.0], abs=1e-6)


def test_the_battery_falls_slowly_then_at_once():
    share = torch.tensor([0.0, 0.25, 0.5, 1.0])
    full, quarter, half, empty = drivetrain().open_voltage(share * 7920.0).tolist()
    assert full == pytest.approx(8.4)
    assert full - quarter == pytest.approx(0.35, abs=0.01)
    assert full - half == pytest.approx(0.70, abs=0.01)
    assert empty == pytest.approx(8.4 - 1.4 - 1.6)


def test_dry_friction_stops_but_never_turns_back():
    speed = torch.tensor([1.0, 0.05, -0.05, -1.0, 0.0])
    assert stopped(speed, torch.tensor(0.1)).tolist() == pytest.approx([0.9, 0, 0, -0.9, 0])


def test_an_open_differential_lets_one_wheel_spin_and_keeps_the_sum():
    engine = drivetrain(differential_viscosity=0.0, rolling_resistance=0.0, gear_friction=0.0)
    tread, load = torch.full((4, 1), 2.0), torch.full((4, 1), 4.0)
    held, lifted = torch.zeros(2, 4, 1), torch.zeros(2, 4, 1)
    held[0, 2:] = 3.0
    lifted[0, 3] = 6.0  # all of it on the right wheel
    current = torch.tensor([10.0])
    even = engine.spun(tread, held, load, current, 1e-3)
    uneven = engine.spun(tread, lifted, load, current, 1e-3)
    assert float(even[2]) == float(even[3])
    assert float(uneven[2]) > 2.0 > float(uneven[3])
    assert float(uneven[2:].sum()) == pytest.approx(float(even[2:].sum()), rel=1e-6)


def test_full_lock_turns_further_to_the_right_and_the_trim_to_the_left():
    angle = steering().angle(torch.tensor([1.0, 0.0, -1.0])).tolist()
    assert angle == pytest.approx([0.348, 0.008, -0.372], abs=1e-6)


def test_the_servo_position_of_an_angle_makes_that_angle():
    servo = torch.linspace(-1, 1, 11)
    torch.testing.assert_close(steering().servo_at(steering().angle(servo)), servo)


def test_with_full_ackermann_both_front_wheels_roll_about_one_point():
    car = steering(ackermann=1.0, steering_trim=0.0)
    cos, sin = car.directions(torch.tensor([0.9]))
    # From the turning centre on the rear axle's line, R = L cot(delta): cot_i = (R -+ t/2) / L.
    cot = cos[:2, 0] / sin[:2, 0]
    assert float(cot[1] - cot[0]) == pytest.approx(0.155 / 0.174, rel=1e-4)
    assert float(cot.mean()) == pytest.approx(1 / math.tan(float(car.angle(torch.tensor(0.9)))))
    torch.testing.assert_close(cos.square() + sin.square(), torch.ones(4, 1))
