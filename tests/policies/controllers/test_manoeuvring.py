"""The driver that brakes, stops and reverses."""

import pytest
import torch
from tensordict import TensorDict

from buggy_rl.core.longitudinal import LongitudinalCommand
from buggy_rl.policies.controllers.at_scale import ManoeuvringDriver
from buggy_rl.policies.controllers.recording import RecordConfig, make_driver, recorded_steps
from buggy_rl.proof.cases.drives import SteadyDriver, TimidDriver, WildDriver
from buggy_rl.simulators import make_engine

COMMANDS = ["throttle_brake_reverse", "current", {"kind": "speed", "reverse": True}]


def drives(command, seed=2, steps=1500, cars=3, simulator="reference"):
    engine = make_engine(simulator, cars, command=command)
    driver = make_driver(RecordConfig("unused", driver="manoeuvring", seed=seed), engine)
    return TensorDict.stack(list(recorded_steps(engine, driver, steps)), 1)


# The reference car takes 10 ms a step unless its command is the first, of which it has a kernel.
@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "simulator"),
    [
        (COMMANDS[0], "reference"),
        *((command, "kinematic") for command in COMMANDS[1:]),
        *(pytest.param(c, "reference", marks=pytest.mark.slow) for c in COMMANDS[1:]),
    ],
)
def test_it_drives_both_ways_brakes_and_stays_in_the_room(command, simulator):
    motion = drives(command, simulator=simulator, steps=1500 if simulator == "reference" else 900)
    vx, throttle = motion["velocity"][..., 0], motion["action"][..., 0]
    assert motion["pose"][..., :2].abs().max() < 4.0  # [m] half the room
    assert vx.max() > 1.5
    assert 0.05 < (vx < -0.2).float().mean() < 0.6
    assert (vx.abs() < 0.05).any()
    assert ((vx > 0.5) & (throttle < 0.1)).any()
    assert throttle.min() < -0.05


def test_the_same_seed_is_the_same_drive_and_another_is_not():
    first, again, other = (
        drives(COMMANDS[0], seed, 150, simulator="kinematic") for seed in (2, 2, 3)
    )
    assert torch.equal(first["action"], again["action"])
    assert not torch.equal(first["action"], other["action"])


def test_setpoints_without_reverse_are_never_below_rest():
    motion = drives("speed", steps=400, simulator="kinematic")
    assert motion["action"][..., 0].min() == -1.0
    assert motion["velocity"][..., 0].max() > 1.0


def test_each_driver_refuses_the_other_s_cars():
    with pytest.raises(ValueError, match="a one-way throttle has no brake: driver=room"):
        ManoeuvringDriver(command=LongitudinalCommand())
    engine = make_engine("reference", 1, command="current")
    with pytest.raises(ValueError, match="reference takes current: driver=manoeuvring"):
        make_driver(RecordConfig("unused"), engine)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [SteadyDriver, TimidDriver, WildDriver])
def test_every_driver_about_the_room_can_be_the_one_that_drives_forward(kind):
    engine = make_engine("reference", 8, command=COMMANDS[0])
    driver = ManoeuvringDriver(seed=2, forward=kind(seed=2))
    motion = TensorDict.stack(list(recorded_steps(engine, driver, 500)), 1)
    vx = motion["velocity"][..., 0]
    assert motion["pose"][..., :2].abs().max() < 6.0  # the wild one spins through a wall
    assert vx.max() > 0.8
    assert (vx < -0.2).any()
    assert ((vx > 0.5) & (motion["action"][..., 0] < -0.05)).any()
