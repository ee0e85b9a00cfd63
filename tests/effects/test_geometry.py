"""What a black box does not say about its body is found by driving it."""

from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import TransformedEnv

from buggy_rl.core import keys
from buggy_rl.core.stepping import reset_at
from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.effects import make_effect
from buggy_rl.effects.measuring import measurable_options, measured_options
from buggy_rl.effects.measuring.geometry import measured_dimensions
from buggy_rl.effects.measuring.tyres import measured_tyres
from buggy_rl.simulators import make_engine
from buggy_rl.simulators.base import Engine
from buggy_rl.simulators.serial import in_single_precision
from tests import plain_env
from tests.effects.faults import follow


@pytest.fixture(scope="module", autouse=True, name="plain")
def compiled():
    """Compiled where it can be: nothing here holds to the last bit."""
    with torch.no_grad():
        yield


BUGGY = VehicleDimensions()
# The plain car as its file says: both axles from its centre of gravity, which is its reference
# point; 0.02 kg m^2 on 1.6 kg.
PLAIN = replace(
    BUGGY,
    wheelbase=0.174,
    cg_to_front_axle=0.082,
    sensor_to_cg=0.0,
    yaw_inertia=BUGGY.mass * 0.02 / 1.6,
)


class FineCar(plain_env.PlainCar):
    """Steps of 0.4 ms, so that Euler's method does not change what the car seems to be."""

    substeps = 25


class ElsewhereCar(FineCar):
    """The same car, seen from 0.03 m ahead of its centre of gravity."""

    AHEAD = 0.03

    def _reset(self, tensordict=None, **_):
        return super()._reset(tensordict)

    def _step(self, tensordict):
        at_cg = tensordict.copy()
        at_cg["velocity"] = moved(tensordict["velocity"], -self.AHEAD)
        after = super()._step(at_cg)
        after["velocity"] = moved(after["velocity"], self.AHEAD)
        return after


def moved(velocity, ahead):
    vx, vy, yaw_rate = velocity.unbind(-1)
    return torch.stack([vx, vy + ahead * yaw_rate, yaw_rate], -1)


def plain(kind, **numbers):
    return lambda count: in_single_precision(kind(count, numbers=numbers))


def close(found, true):
    assert found.wheelbase == pytest.approx(true.wheelbase, abs=0.002)
    assert found.cg_to_front_axle == pytest.approx(true.cg_to_front_axle, abs=0.006)
    assert found.sensor_to_cg == pytest.approx(true.sensor_to_cg, abs=0.006)
    assert found.yaw_inertia == pytest.approx(true.yaw_inertia, rel=0.03)


def test_the_body_of_a_users_own_simulator_is_found():
    close(measured_dimensions(plain(FineCar), BUGGY), PLAIN)


def test_where_its_velocity_is_seen_is_found():
    close(measured_dimensions(plain(ElsewhereCar), BUGGY), replace(PLAIN, sensor_to_cg=0.03))


def test_what_no_step_shows_is_kept():
    found = measured_dimensions(plain(FineCar), replace(BUGGY, mass=3.0))
    assert found.mass == 3.0
    assert found.yaw_inertia == pytest.approx(3.0 * 0.02 / 1.6, rel=0.03)
    assert found.cg_height == BUGGY.cg_height


@pytest.mark.parametrize(
    ("engine", "axle", "inertia"),
    # A steered double track rolls and transfers load, which a car on two axles does not.
    [("single_track", 0.002, 0.03), ("reference", 0.006, 0.2), ("mujoco", 0.006, 0.1)],
)
def test_it_agrees_with_what_an_engine_says_of_itself(engine, axle, inertia):
    def make(count):
        return make_engine(engine, (count,))

    car = make(1)
    assert isinstance(car, Engine)
    said, found = car.vehicle(), measured_dimensions(make, BUGGY)
    for car in (said, found):
        assert car.cg_to_front_axle - car.sensor_to_cg == pytest.approx(0.059, abs=axle)
        assert car.cg_to_rear_axle + car.sensor_to_cg == pytest.approx(0.115, abs=axle)
    assert found.yaw_inertia == pytest.approx(said.yaw_inertia, rel=inertia)


def test_a_car_whose_tyres_never_slide_does_not_show_its_axles():
    linear = plain(plain_env.QuickCar, grip=40.0, stiffness=0.12)
    with pytest.raises(ValueError, match=r"do not saturate within 0\.4 rad"):
        measured_dimensions(linear, BUGGY)
    options, failures = measurable_options(linear)
    assert "those of the buggy are assumed" in failures[0]
    assert "dimensions" not in options["tire_grip"]


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["kinematic", "hold"])
def test_what_is_no_car_on_two_axles_is_refused(engine):
    with pytest.raises(ValueError, match=r"a car on two axles leaves .* unexplained"):
        measured_dimensions(lambda count: make_engine(engine, (count,)), BUGGY)


def test_every_force_acts_on_the_body_that_was_found():
    options = measured_options(plain(FineCar))
    for name in ("tire_grip", "payload", "one_sided_drag", "yaw_damping", "wind", "understeer"):
        close(replace(BUGGY, **options[name]["dimensions"]), PLAIN)
    assert "dimensions" not in options["throttle_gain"]


def test_what_a_cars_file_says_is_taken_where_no_step_shows_it():
    linear = plain(plain_env.QuickCar, grip=40.0, stiffness=0.12)
    car = replace(BUGGY, mass=4.0, wheelbase=0.33)
    options, failures = measurable_options(linear, typical=car, lock=0.6)
    assert "those of the car's file are assumed" in failures[0]
    assert options["payload"]["dimensions"] == {"mass": 4.0, "wheelbase": 0.33}
    # Wheels that turn further than effects allow for: 0.6 rad and 15 % of it.
    assert options["steering_drag"]["lock"] == options["understeer"]["lock"] == 0.69
    assert "lock" not in measurable_options(linear, lock=0.38)[0]["steering_drag"]


def rollout(env):
    """Positions [T, 16, 2] of cars that set off at 2 to 3.5 m/s and swing from lock to lock."""
    start = TensorDict({keys.VELOCITY: torch.zeros(16, 3), keys.POSE: torch.zeros(16, 3)}, [16])
    start[keys.VELOCITY][:, 0] = torch.linspace(2.0, 3.5, 16)
    time = 0.01 * torch.arange(80)
    actions = torch.stack([torch.full_like(time, -0.2), torch.sin(6 * time)], -1)
    states: TensorDictBase = follow(env, reset_at(env, start), actions)  # type: ignore[assignment]
    return states.get(keys.POSE)[..., :2]


@pytest.mark.slow
def test_less_grip_around_a_black_box_does_what_less_grip_inside_it_does():
    make = plain(plain_env.QuickCar)
    truth = rollout(plain(plain_env.QuickCar, grip=0.85 * 0.5, stiffness=6.0 / 0.5)(16))
    bare = (rollout(make(16)) - truth).norm()
    assert float(bare) > 1.0
    closed = []
    own, typical = measured_options(make)["tire_grip"], measured_tyres(make, BUGGY)
    ellipse = own | {"combined_slip": 1.0, "resistance": [0.7, 1.1]}  # that it does not have
    for known in (own, typical, ellipse):
        effect = make_effect("tire_grip", {"grip": 0.5}, **known)
        left = (rollout(TransformedEnv(make(16), effect)) - truth).norm()
        closed.append(1 - float(left / bare))
    assert closed[0] > 0.9
    assert max(closed[1:]) < 0.87


@pytest.mark.parametrize(
    ("engine", "combined"), [("single_track", 0.0), ("mujoco", 1.0), ("reference", 1.0)]
)
def test_whether_the_drive_takes_from_the_side_force_is_seen(engine, combined):
    found = measured_tyres(lambda count: make_engine(engine, (count,)), BUGGY)
    assert found["combined_slip"] == combined


def test_a_plain_car_has_no_friction_ellipse():
    found = measured_tyres(plain(FineCar), PLAIN)
    assert found["combined_slip"] == 0.0
    assert found["resistance"] == [0.0, 0.0]
