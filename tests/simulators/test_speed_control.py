"""A speed setpoint in the place of the throttle."""

import pytest
import torch
from tensordict import TensorDict

from buggy_rl.core.car_file import load_car
from buggy_rl.simulators import make_engine
from buggy_rl.simulators.bicycle.longitudinal import controlled_force

ENGINES = ["single_track", "kinematic"]


def driven(engine, drive, seconds, speed=0.0):
    """Velocity [*, 3] after holding a command in 0..1, from one speed or one of each car."""
    velocity = torch.zeros(*engine.batch_size, 3)
    velocity[..., 0] = torch.as_tensor(speed)
    start = TensorDict({"pose": 0 * velocity, "velocity": velocity}, engine.batch_size)
    state = engine.reset(start, set_state=True)
    for _ in range(round(seconds / engine.dt)):
        state["action"] = torch.tensor([2 * drive - 1, 0.0]).expand(*engine.batch_size, 2).clone()
        state = engine.step(state)["next"].exclude("reward")
    return state["velocity"]


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize("drive", [0.0, 0.3, 0.6])
def test_the_car_settles_near_the_setpoint_from_below_and_above(name, drive):
    values = {"full_speed": 4.0, "speed_gain": 60.0}
    engine = make_engine(name, 2, command="speed", parameters=values)
    below, above = driven(engine, drive, 2.5, torch.tensor([0.0, 3.5]))[:, 0].tolist()
    assert below == pytest.approx(above, abs=0.02)  # [m/s] one steady state
    # A proportional controller stays below by resistance / gain: at most 3 N / 60 N s/m.
    assert 4.0 * drive - 0.05 <= below <= 4.0 * drive + 1e-3


def test_braking_and_pulling_are_limited_by_what_the_motor_and_its_brake_can():
    values = {
        "full_speed": 5.0, "speed_gain": 100.0, "brake_force": 8.0,
        "drive_force": 10.0, "drive_force_loss": 2.0,
    }  # fmt: skip
    values = {name: torch.tensor(value) for name, value in values.items()}
    vx = torch.tensor([0.0, 2.0, 4.0, 4.9, 5.0])
    force = controlled_force(vx, torch.tensor(1.0), values)
    # wanted 500, 300, 100, 10, 0; available 10 - 2 v
    assert force.tolist() == pytest.approx([10.0, 6.0, 2.0, 0.2, 0.0], abs=1e-4)
    assert controlled_force(vx[2], torch.tensor(0.0), values).item() == pytest.approx(-8.0)


def test_at_rest_a_zero_setpoint_keeps_the_car_at_rest():
    engine = make_engine("single_track", command="speed")
    assert driven(engine, 0.0, 2.0).abs().max() < 1e-6


def test_a_reset_at_speed_continues_at_that_speed():
    engine = make_engine("single_track", command="speed")
    start = TensorDict({"pose": torch.zeros(3), "velocity": torch.tensor([2.0, 0.0, 0.0])}, [])
    state = engine.reset(start, set_state=True)
    state["action"] = state["commands"][0]  # the command that a steady drive is assumed to have
    for _ in range(50):
        state = engine.step(state)["next"].exclude("reward").set("action", state["commands"][0])
    assert state["velocity"][0].item() == pytest.approx(2.0, abs=0.02)


def test_a_setpoint_has_parameters_of_its_own_and_no_dead_band_of_a_throttle():
    engine = make_engine("single_track", 2, command="speed", parameters={"full_speed": 3.0})
    assert {"full_speed", "speed_gain", "brake_force"} <= set(engine.declared)
    assert "throttle_deadband" not in engine.declared
    assert "full_speed" not in make_engine("single_track").declared
    copy = engine.with_parameters(TensorDict({"speed_gain": torch.tensor([5.0, 9.0])}, [2]))
    assert copy.command.kind == "speed"
    assert copy.values["full_speed"].item() == 3.0


def test_the_car_s_file_says_what_the_command_is(tmp_path):
    engine = make_engine("single_track", car="frictionmaps")
    assert engine.command.kind == "speed"
    assert engine.values["full_speed"].item() == load_car("frictionmaps").command.full_speed
    file = tmp_path / "mine.yaml"
    file.write_text(
        "dimensions: {mass: 3.0, wheelbase: 0.3}\ncommand: {kind: speed, full_speed: 4.0}\n"
    )
    assert make_engine("mujoco", car=str(file)).values["full_speed"] == 4.0


def test_an_unknown_kind_of_command_is_refused():
    with pytest.raises(ValueError, match="command is 'clutch': must be one of throttle, "):
        make_engine("single_track", command="clutch")
