"""Brakes and reverse: physics as properties, over all engines that take such a command."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import check_env_specs

from buggy_rl.simulators import make_engine
from buggy_rl.simulators.bicycle.longitudinal import (
    braking_force,
    current_force,
    esc_drive,
    rolling_forward,
)

ESC = "throttle_brake_reverse"
SETPOINT = {"kind": "speed", "reverse": True}
ENGINES = ["kinematic", "single_track", "mujoco", "reference"]
DRIVES = ["rear", "front", "all"]


@torch.no_grad()
def driven(engine, commands, vx=0.0):
    """Velocities and poses [T, N, 3] after commands of (throttle, steering, steps).

    Of one car [T, 3]. Throttle, steering and the first speed are of all cars or one for each.
    """
    (count,) = engine.batch_size
    velocity = torch.zeros(count, 3)
    velocity[:, 0] = torch.as_tensor(vx)
    state, rows = (
        engine.reset(
            TensorDict({"pose": 0 * velocity, "velocity": velocity}, [count]), set_state=True
        ),
        [],
    )
    for throttle, steering, steps in commands:
        action = torch.stack([torch.as_tensor(v).expand(count) for v in (throttle, steering)], -1)
        for _ in range(steps):
            state["action"] = action.clone()
            state = engine.step(state)["next"].exclude("reward")
            rows.append(torch.cat([state["velocity"], state["pose"]], -1))
    return torch.stack(rows)[:, 0 if count == 1 else slice(None)].split(3, -1)


def straight(name, command=ESC, count=1, **parameters):
    """Cars without a trim that pulls them aside."""
    own = {"steering_trim": 0.0} if name == "reference" else {}
    return make_engine(name, count, command=command, parameters={**own, **parameters})


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize("command", [ESC, SETPOINT, "current"])
def test_it_keeps_its_specs(name, command):
    check_env_specs(make_engine(name, (3,), command=command))


def test_backwards_by_the_mirrored_command_the_path_of_the_rear_axle_is_the_mirror_image():
    # Sensor at the rear axle; the same motor both ways.
    same = {"sensor_x": -0.093, "reverse_share": 1.0, "reverse_deadband": 0.05}
    engine = straight("kinematic", **same)
    ahead = driven(engine, [(0.4, 0.6, 80), (0.0, -0.3, 40)])
    back = driven(engine, [(-0.4, 0.6, 80), (0.0, -0.3, 40)])
    mirror = torch.tensor([-1.0, 1.0, -1.0])  # x and yaw, vx and yaw rate
    assert ahead[1][-1, 0] > 0.3
    for forward, backward in zip(ahead, back, strict=True):
        torch.testing.assert_close(backward, forward * mirror, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("name", ["single_track", "mujoco", "reference"])
def test_a_crawl_in_reverse_follows_the_kinematic_arc(name):
    # 0.3 m/s: hardly any slip. The wheels point left, so the tail goes left: yaw to the right.
    engine = straight(name, SETPOINT)
    velocity, _ = driven(engine, [(-0.06, 0.5, 140)])
    vx, _, yaw_rate = velocity[-1]
    left = {"single_track": 0.45 * torch.tanh(torch.tensor(0.55)), "mujoco": torch.tensor(0.18)}
    angle = left.get(name, torch.tensor(0.175))  # 0.36 / 2 less a bit of the unequal locks
    assert -0.35 < vx < -0.15
    assert yaw_rate == pytest.approx(float(vx * torch.tan(angle) / 0.174), rel=0.06)


@pytest.mark.parametrize("name", ENGINES)
def test_brakes_never_push_a_standing_car(name):
    speeds = [0.0, 1.5, -1.5]
    engine = straight(name, count=3, drag_brake=2.0)
    velocity, _ = driven(engine, [(0.0, torch.tensor([0.2, 0.0, 0.0]), 200)], torch.tensor(speeds))
    assert velocity[:, 0].abs().max() < 1e-4
    for car in (1, 2):  # nor one that they have stopped
        stopped = velocity[:, car]
        assert stopped[-1].abs().max() < 2e-2
        # The reference car's carcasses spring back: 2 N against 3850 N/m and 1.6 kg, 0.025 m/s.
        rebound = 0.05 if name == "reference" else 1e-3
        assert (stopped[:, 0] * speeds[car]).min() > -rebound


@pytest.mark.parametrize("name", ENGINES)
def test_a_braked_car_loses_speed_every_step_and_the_more_the_harder(name):
    throttles = torch.tensor([-0.4, -0.9, 0.0])
    velocities, poses = driven(straight(name, count=3), [(throttles, 0.1, 150)], 2.0)
    way = []
    for velocity, pose in zip(velocities.unbind(1)[:2], poses.unbind(1), strict=False):
        speed = velocity[:, :2].norm(dim=-1)
        braking = velocity[:, 0] > 0.3
        assert braking.sum() > 10
        assert (speed.diff()[braking[1:]] <= 1e-5).all()
        way.append(pose[braking][-1, 0])
    assert way[1] < way[0] < poses[-1, 2, 0]


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize(
    "command", [ESC, *(pytest.param(c, marks=pytest.mark.slow) for c in (SETPOINT, "current"))]
)
def test_brake_then_reverse_then_forward_is_free_of_jumps(name, command):
    velocity, pose = driven(
        straight(name, command, 2), [(0.5, 0.0, 65), (-0.6, 0.0, 110), (0.5, 0.0, 75)]
    )
    velocity, pose = velocity[:, 0], pose[:, 0]
    vx = velocity[:, 0]
    assert vx[64] > 1.0
    assert vx[174] < -0.5
    assert vx[-1] > 0.3
    assert pose[-1, 1].abs() < 0.05
    # 18 N and 8 N of brake on 1.6 kg are 16 m/s^2: 0.16 m/s a step at most.
    assert vx.diff().abs().max() < 0.16


@pytest.mark.parametrize("name", ENGINES)
def test_a_reset_in_reverse_goes_on_in_reverse(name):
    velocity, pose = driven(straight(name), [(-0.3, 0.0, 20)], -1.0)
    assert velocity[0, 0] == pytest.approx(-1.0, abs=0.06)
    assert pose[-1, 0] < -0.1


@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("tyres", ["explicit", pytest.param("contact", marks=pytest.mark.slow)])
def test_mujoco_drives_and_brakes_the_wheels_it_is_told_to(drive, tyres):
    engine = make_engine("mujoco", 1, command=ESC, drive=drive, tyres=tyres)
    assert engine.values["brake_front_share"] == {"rear": 0.0, "front": 1.0, "all": 0.5}[drive]
    velocity, _ = driven(engine, [(0.6, 0.0, 60), (-1.0, 0.0, 40), (-1.0, 0.0, 150)])
    vx = velocity[:, 0]
    assert vx[59] > 1.0
    assert vx[99] < vx[59] - 0.8  # [m/s] 8 N on 1.6 kg for 0.4 s is 2 m/s, less the lags
    assert vx[-1] < -0.5
    assert velocity[:, 1:].abs().max() < 1e-3


def test_mujoco_refuses_a_drive_it_does_not_know():
    with pytest.raises(ValueError, match=r"drive is 'left'; expected one of rear, front, all"):
        make_engine("mujoco", 1, drive="left")


def test_the_laws_are_what_their_equations_say():
    v = {"drive_force": 10.0, "drive_force_loss": 1.0, "throttle_deadband": 0.1}
    v |= {"reverse_deadband": 0.2, "reverse_share": 0.5, "brake_force": 8.0, "drag_brake": 2.0}
    v = {name: torch.tensor(value) for name, value in v.items()}
    speed = torch.tensor([2.0, 0.0, -2.0])
    # Forward (10 - v) 0.5; backward 0.5 (10 + v) 0.3, and nothing of it above 0.2 m/s.
    forward = esc_drive(speed, rolling_forward(speed), torch.tensor(0.6), v)
    assert forward.tolist() == pytest.approx([4.0, 5.0, 6.0])
    backward = esc_drive(speed, rolling_forward(speed), torch.tensor(-0.5), v)
    assert backward.tolist() == pytest.approx([0.0, -1.5, -1.2])
    # Brake 8 (0.5 - 0.2) forward only; drag 2 without a command, either way.
    assert braking_force(speed, torch.tensor(-0.5), v).tolist() == pytest.approx([-2.4, 0.0, 0.0])
    assert braking_force(speed, torch.tensor(0.0), v).tolist() == pytest.approx([-2.0, 0.0, 2.0])
    # Current: 10 d, along the motion at most 10 - 2.
    assert current_force(speed, None, torch.tensor(0.9), v).tolist() == pytest.approx([8, 9, 9])


def test_forces_are_continuous_where_the_car_stops():
    engine = make_engine("single_track", command=ESC, parameters={"drag_brake": 3.0})
    vx = torch.linspace(-0.5, 0.5, 2001)  # steps of 0.5 mm/s
    for drive in (-1.0, -0.3, 0.0, 0.5):
        force = engine.law.drive(vx, torch.tensor(drive), engine.values)
        force = force + engine.law.brake(vx, torch.tensor(drive), engine.values)
        assert force.diff().abs().max() < 0.05  # [N] of up to 10


def test_a_one_way_car_has_none_of_it():
    for name in ENGINES:
        declared = make_engine(name, 1).declared
        assert not {"brake_force", "drag_brake", "full_speed"} & set(declared), name
