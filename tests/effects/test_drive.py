import math

import pytest
import torch
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.effects import effect_class, make_effect
from buggy_rl.effects.measuring.drive import measured_drive, measured_motor, measured_onset
from buggy_rl.effects.motion.base import Motion
from buggy_rl.effects.motion.drive import turning_drag
from buggy_rl.simulators import make_engine
from tests.effects.faults import follow, over, start

# A car of known motor: no lags, no friction but a constant and a viscous one.
PLAIN = {
    "throttle_dead_time": 0.0,
    "throttle_lag": 0.0,
    "steering_drag": 0.0,
    "steering_drag_speed": 0.0,
    "quadratic_drag": 0.0,
    "throttle_deadband": 0.0,
    "dry_friction": 0.8,
    "viscous_friction": 0.35,
    "drive_force": 10.0,
    "drive_force_loss": 0.6,
}
MASS = 1.625
KNOWN = {"coasting": (0.8 / MASS, 0.35 / MASS)}


def plain(batch_size=()):
    return make_engine("single_track", batch_size, parameters=PLAIN)


def accelerated(effects, speed, drive, engine=None):
    """Acceleration of the first step [m/s^2]."""
    env = over(effects, engine or plain())
    actions = torch.tensor([[2 * drive - 1, 0.0]])
    after = follow(env, start(env, (speed, 0.0, 0.0)), actions)[0]
    return (float(after[keys.VELOCITY][0]) - speed) / 0.01


def test_the_drive_is_measured_for_what_it_is():
    found = measured_drive(plain)
    assert found["coasting"] == pytest.approx(KNOWN["coasting"], rel=0.01)
    # The single track's motor loses 0.6 N s/m in proportion to the drive.
    assert found["speed_loss"] == pytest.approx((0.0, 0.6 / MASS), abs=0.01)


@pytest.mark.parametrize(("engine", "deadband"), [("reference", 0.16), ("single_track", 0.05)])
def test_a_motors_onset_is_its_deadband(engine, deadband):
    onset = measured_onset(lambda n: make_engine(engine, n))
    assert onset == pytest.approx(deadband, abs=0.003)


@pytest.mark.parametrize("engine", ["reference", "single_track"])
def test_one_batch_shows_what_two_do(engine):
    def make(count):
        return make_engine(engine, count)

    assert measured_motor(make) == measured_drive(make) | {"onset": measured_onset(make)}


def test_a_simulator_without_a_motor_has_no_onset():
    with pytest.raises(ValueError, match="no drive up to"):
        measured_onset(lambda n: make_engine("hold", n))


def test_power_is_bounded_at_the_speed_it_is_given_at():
    # At 2 m/s and full drive the motor gives (10 - 1.2) / 1.625 = 5.415 m/s^2, that is 10.8 W/kg.
    # Of 6 W/kg there are 3 m/s^2, less what friction takes: 0.8 / 1.625 + 2 * 0.35 / 1.625.
    limit = make_effect("motor_power_limit", {"power_per_mass": 6.0}, **KNOWN)
    expected = 3.0 - (0.8 + 0.7) / MASS
    assert accelerated([limit], 2.0, 1.0) == pytest.approx(expected, abs=0.05)
    # At half a throttle less than that is asked for: 4.4 / 1.625 * 2 = 5.4 W/kg.
    bare = accelerated([], 2.0, 0.5)
    limit = make_effect("motor_power_limit", {"power_per_mass": 6.0}, **KNOWN)
    assert accelerated([limit], 2.0, 0.5) == pytest.approx(bare, abs=1e-3)


def test_a_car_with_a_power_limit_settles_where_power_meets_resistance():
    # P = (0.8 + 0.35 v) v / m: at v = 3 m/s, 3.415 W/kg.
    power = (0.8 + 0.35 * 3.0) * 3.0 / MASS

    def gained(speed):
        limit = make_effect("motor_power_limit", {"power_per_mass": power}, **KNOWN)
        return accelerated([limit], speed, 1.0)

    assert gained(3.0) == pytest.approx(0.0, abs=0.02)
    assert gained(2.8) > 0.05
    assert gained(3.2) < -0.05


@pytest.mark.parametrize("drive", [0.3, 0.7])
def test_a_slower_motor_loses_its_drive_earlier(drive):
    # (10 - 0.6 v / 0.8) d: at 3 m/s the loss of 1.8 N becomes one of 2.25 N.
    options = {**KNOWN, "speed_loss": (0.0, 0.6 / MASS)}
    slower = make_effect("top_speed", {"speed_ratio": 0.8}, **options)
    change = accelerated([slower], 3.0, drive) - accelerated([], 3.0, drive)
    assert change == pytest.approx(-0.45 * drive / MASS, rel=0.05)


@pytest.mark.parametrize("name", ["top_speed", "motor_power_limit"])
def test_without_throttle_the_motor_does_not_matter(name):
    values = {"top_speed": {"speed_ratio": 0.5}, "motor_power_limit": {"power_per_mass": 0.5}}
    for speed in (0.0, 0.5, 3.0):
        with_it = accelerated([make_effect(name, values[name])], speed, 0.0)
        assert with_it == pytest.approx(accelerated([], speed, 0.0), abs=1e-6)


def test_a_payload_divides_what_accelerates():
    # Straight ahead, with nothing in proportion to the load: the whole acceleration.
    bare = accelerated([], 2.0, 0.6)
    heavy = make_effect("payload", {"mass_ratio": 1.25}, rolling=0.0)
    assert accelerated([heavy], 2.0, 0.6) == pytest.approx(bare / 1.25, rel=1e-3)
    # What rubber takes, here 0.2 m/s^2, grows with the load: (a + 0.2) / 1.25 - 0.2.
    rubber = make_effect("payload", {"mass_ratio": 1.25}, rolling=0.2)
    expected = (bare + 0.2) / 1.25 - 0.2
    assert accelerated([rubber], 2.0, 0.6) == pytest.approx(expected, rel=1e-3)


def test_a_payload_is_what_the_engine_does_with_more_mass():
    ratio, actions = 1.3, torch.tensor([[0.1, 0.25]]).expand(100, 2)
    lone = make_engine("single_track", (1,))
    values = {name: (ratio * lone.values[name]).expand(1) for name in ("mass", "yaw_inertia")}
    engines = {
        "heavy": lone.with_parameters(TensorDict(values, [1])),
        "bare": make_engine("single_track", (1,)),
        "laden": over(
            [make_effect("payload", {"mass_ratio": ratio}, rolling=0.0)], "single_track", (1,)
        ),
    }
    ends = {
        name: follow(env, start(env, (1.5, 0.0, 0.0)), actions)[-1][keys.POSE][0, :2]
        for name, env in engines.items()
    }
    missed = float((ends["bare"] - ends["heavy"]).norm())
    left = float((ends["laden"] - ends["heavy"]).norm())
    assert missed > 0.05
    assert left < 0.25 * missed
    assert math.isfinite(left)


@pytest.mark.parametrize("drive", [0.3, 0.7])
def test_a_shorter_gear_has_more_force_and_less_speed(drive):
    # F = (10 - 0.6 v) d; of 1.25 times the gear 1.25 (10 - 0.6 1.25 v) d.
    options = {**KNOWN, "speed_loss": (0.0, 0.6 / MASS)}
    gear = make_effect("gear_ratio", {"ratio": 1.25}, **options)
    for speed in (1.0, 3.0):
        change = accelerated([gear], speed, drive) - accelerated([], speed, drive)
        more = 1.25 * (10 - 0.75 * speed) - (10 - 0.6 * speed)
        assert change == pytest.approx(more * drive / MASS, rel=0.05, abs=0.01)


def test_a_resistance_of_the_supply_takes_with_the_square_of_the_drive():
    sag = make_effect("voltage_sag", {"resistance_ratio": 0.5}, **KNOWN)
    for drive, left in ((1.0, 1 / 1.5), (0.5, 1 / 1.125)):
        force = drive * (10 - 1.2) / MASS  # at 2 m/s
        change = accelerated([sag], 2.0, drive) - accelerated([], 2.0, drive)
        assert change == pytest.approx(-(1 - left) * force, rel=0.03)


@pytest.mark.parametrize("name", ["gear_ratio", "voltage_sag"])
def test_a_coasting_car_has_no_gear_and_no_supply(name):
    value = {"gear_ratio": {"ratio": 1.5}, "voltage_sag": {"resistance_ratio": 1.0}}[name]
    for speed in (0.5, 3.0):
        with_it = accelerated([make_effect(name, value)], speed, 0.0)
        assert with_it == pytest.approx(accelerated([], speed, 0.0), abs=1e-6)


@pytest.mark.parametrize(
    ("ratio", "said"), [(0.25, "drops under load: at full throttle the motor pulls 20 % less"),
                        (-0.2, "holds under load: at full throttle the motor pulls 25 % more")],
)  # fmt: skip
def test_a_supply_that_drops_or_holds_is_said_so(ratio, said):
    assert said in effect_class("voltage_sag").sentence({"resistance_ratio": ratio})


@pytest.mark.parametrize(("vx", "yaw_rate"), [(2.0, 0.6), (4.0, -0.3), (2.0, 0.0)])
def test_turned_wheels_brake_by_their_side_force_times_the_tangent_of_their_angle(vx, yaw_rate):
    # A steady bend: the front axle carries lr / L of m vx r, its wheels stand at L r / vx.
    car, moving = VehicleDimensions(), torch.tensor([[vx, 0.0, yaw_rate]])
    motion = Motion(torch.zeros(1, 3), moving, moving, torch.zeros(1, 2), 0.01)
    share = car.cg_to_rear_axle / car.wheelbase
    expected = share * vx * yaw_rate * math.tan(car.wheelbase * yaw_rate / vx)
    assert float(turning_drag(motion, car)) == pytest.approx(expected, rel=1e-3, abs=1e-6)
