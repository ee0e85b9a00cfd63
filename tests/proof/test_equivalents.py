"""What a right number is."""

import pytest
import torch
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.effects import effect_class
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.equivalents import (
    GROUPS,
    MASS_SHARE,
    NEAR,
    SAME,
    SCALED,
    error,
    expected,
    meant,
    same_group,
)
from buggy_rl.proof.plants import PLANTS, abilities, make_plant
from buggy_rl.simulators.reference import ReferenceEngine


def test_a_slope_moves_the_wheels_too():
    drivetrain = ReferenceEngine(1).car.drivetrain
    share = float(drivetrain.rolling_mass / drivetrain.values["mass"])
    assert share == pytest.approx(1 / MASS_SHARE["reference"], abs=1e-3)
    slope = Case(1, "reference", "mujoco_fitted", concealed={
        "floor_slope": {"along_x": 0.3, "along_y": -0.2}})  # fmt: skip
    assert expected(slope, "floor_slope")["along_x"] == pytest.approx(0.3 / share, rel=1e-3)


@pytest.mark.parametrize(
    "plant", [plant for plant in PLANTS if "motor_power_limit" in abilities(plant)]
)
def test_power_at_the_shaft_arrives_as_acceleration_of_car_and_wheels(plant):
    # What full throttle gives over coasting, times the speed, is the power over all that moves.
    limit, speed = 3.0, torch.tensor([2.0, 3.0])
    faults = {"motor_power_limit": {"power_per_mass": limit}}
    given = gained(plant, faults, speed, 0.4) - gained(plant, {}, speed, -1.0)
    case = Case(1, plant, "mujoco_fitted", concealed=faults)
    right = expected(case, "motor_power_limit")["power_per_mass"]
    assert given * speed == pytest.approx([right, right], rel=0.04)


def gained(plant, faults, speed, throttle):
    """Acceleration [n] at speeds [n] after delays have settled."""
    car = make_plant(plant, len(speed), faults)
    held = torch.stack([speed, 0 * speed, 0 * speed], -1)
    pose = torch.zeros_like(held)
    state = car.reset(
        TensorDict({keys.POSE: pose, keys.VELOCITY: held}, [len(speed)]), set_state=True
    )
    action = torch.tensor([[throttle, 0.0]]).expand(len(speed), 2)
    for row in range(63):
        if row <= 60:
            state[keys.VELOCITY] = held
        state[keys.ACTION] = action
        state = car.step(state)["next"]
    return (state[keys.VELOCITY][:, 0] - speed) / (3 * CONTROL_PERIOD)


def test_what_the_textbook_and_the_car_have_in_common_is_left_alone():
    case = Case(1, "reference", "reference", concealed={"payload": {"mass_ratio": 1.3}})
    assert expected(case, "payload") == {"mass_ratio": 1.3}
    assert all(effect_class(effect).name == effect for effect in SCALED)


def test_a_vectors_error_is_that_of_the_arrow():
    # |(0.3, 0.4) - (0.3, 0.3)| / |(0.3, 0.3)| = 0.1 / 0.424
    said, true = {"force_x": 0.3, "force_y": 0.4}, {"force_x": 0.3, "force_y": 0.3}
    assert error("wind", said, true) == pytest.approx(0.2357, abs=1e-3)
    assert error("payload", {"mass_ratio": 1.1}, {"mass_ratio": 1.0}) == pytest.approx(0.1)


def test_a_patchs_error_is_its_worst():
    true = {"x": 1.0, "y": 0.0, "radius": 1.0, "grip": 0.5}
    assert error("grip_patch", {**true, "x": 1.3}, true) == pytest.approx(0.3)
    assert error("grip_patch", {**true, "grip": 0.4}, true) == pytest.approx(0.2)


def test_names_of_parameters_stand_for_effects():
    assert meant("parameter:steering_lag") == "steering_lag"
    assert meant("parameter:grip_front") == "parameter:grip_front"
    assert meant("steering_lag") == "steering_lag"
    assert same_group("parameter:grip_front", "tire_grip")
    assert same_group("floor_slope", "wind")
    assert not same_group("floor_slope", "steering_lag")


def test_tables_of_names_hold_only_effects_that_there_are():
    for name in {*SAME.values(), *NEAR.values(), *set().union(*GROUPS)}:
        assert effect_class(name).name == name
