import math
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp
from tensordict import TensorDict
from vehiclemodels.parameters_vehicle2 import parameters_vehicle2
from vehiclemodels.vehicle_dynamics_st import vehicle_dynamics_st

import buggy_rl.simulators
from buggy_rl.core import keys
from buggy_rl.core.vehicle import GRAVITY, shift_pose, shift_velocity
from buggy_rl.simulators import make_engine
from buggy_rl.simulators.bicycle.actuation import (
    ACTUATOR,
    dead_time_weights,
    mean_lag_decay,
    road_wheel_angle,
    steering_command,
)
from buggy_rl.simulators.bicycle.longitudinal import resistance
from buggy_rl.simulators.bicycle.single_track import SLIP_SPEED, SingleTrackEngine, rolling_speed

DIRECT = {"throttle_dead_time": 0, "throttle_lag": 0, "steering_dead_time": 0, "steering_lag": 0}
FREE = dict.fromkeys(
    (
        "dry_friction",
        "viscous_friction",
        "quadratic_drag",
        "steering_drag",
        "steering_drag_speed",
        "drive_force",
    ),
    0.0,
)
AT_CG = {"sensor_x": 0, "sensor_y": 0}


def drive(engine, actions, velocity=(0.0, 0.0, 0.0)):
    """Poses and velocities [*, T + 1, 3] from the origin under actions [T, 2] or [*, T, 2]."""
    batch = engine.batch_size
    start = TensorDict(batch_size=batch)
    start["pose"] = torch.zeros(*batch, 3)
    start["velocity"] = torch.as_tensor(velocity, dtype=torch.float32).expand(*batch, 3).clone()
    state = engine.reset(start, set_state=True)
    actions = torch.as_tensor(actions, dtype=torch.float32)
    actions = actions.expand(*batch, *actions.shape[-2:])
    poses, velocities = [state["pose"]], [state["velocity"]]
    for action in actions.unbind(-2):
        state[keys.ACTION] = action
        state = engine._step_mdp(engine.step(state))
        poses.append(state["pose"])
        velocities.append(state["velocity"])
    return torch.stack(poses, -2), torch.stack(velocities, -2)


def held(throttle, steering, seconds):
    return torch.tensor([[throttle, steering]]).expand(round(seconds * 100), 2)


def test_it_drives_as_the_single_track_model_of_commonroad_while_tyres_are_linear():
    peer = parameters_vehicle2()
    peer.h_s = 0.0  # axle loads are static here
    stiffness = -peer.tire.p_ky1  # its mu C_S: lateral force over load and slip angle [1/rad]
    grip = 20.0  # far out of reach, so that sin(C atan(B alpha)) is B alpha
    values = {
        **{name: 0.0 for name in (*DIRECT, *FREE, *AT_CG, "steering_offset")},
        "mass": peer.m,
        "yaw_inertia": peer.I_z,
        "cg_to_front_axle": peer.a,
        "cg_to_rear_axle": peer.b,
        **{f"{axle}_grip": grip * 9.81 / GRAVITY for axle in ("front", "rear")},
        **{f"{axle}_shape": 1.0 for axle in ("front", "rear")},
        **{f"{axle}_stiffness": stiffness / grip for axle in ("front", "rear")},
        **{f"{side}_angle": 1.0 for side in ("left", "right")},
        **{f"{side}_steepness": 1.0 for side in ("left", "right")},
    }
    car = SingleTrackEngine().with_parameters(
        TensorDict({n: torch.tensor(v) for n, v in values.items()})
    )
    angle = 0.01 * torch.sin(torch.arange(200) * 0.01 * 4.0)  # 10 mrad at 4 rad/s
    steering = steering_command(angle, car.values)
    actions = torch.stack([torch.full_like(steering, -1.0), steering], -1)
    pose, velocity = drive(car, actions, (20.0, 0.0, 0.0))
    speed = velocity[:, :2].norm(dim=-1).double().numpy()

    state = np.array([0.0, 0.0, 0.0, 20.0, 0.0, 0.0, 0.0])
    theirs = [state]
    for k in range(200):
        state = state.copy()
        state[2] = float(angle[k])
        inputs = [0.0, (speed[k + 1] - speed[k]) / 0.01]
        state = solve_ivp(
            lambda _, x, u=inputs: vehicle_dynamics_st(x, u, peer), (0, 0.01), state, rtol=1e-8
        ).y[:, -1]
        theirs.append(state)
    x, y, _, v, yaw, yaw_rate, sideslip = np.stack(theirs, -1)

    assert np.abs(yaw_rate).max() > 0.05  # rad/s: it does turn
    np.testing.assert_allclose(velocity[:, 2], yaw_rate, atol=2e-3 * np.abs(yaw_rate).max())
    lateral = v * np.sin(sideslip)
    np.testing.assert_allclose(velocity[:, 1], lateral, atol=2e-3 * np.abs(lateral).max())
    np.testing.assert_allclose(pose[:, 2], yaw, atol=2e-3 * np.abs(yaw).max())
    np.testing.assert_allclose(pose[:, :2], np.stack([x, y], -1), atol=2e-3)  # m, of 40 m


def test_steady_cornering_shows_the_understeer_that_the_tyres_give():
    # r = v delta / (L + K v^2), K = (1 / (B C D)_front - 1 / (B C D)_rear) / g, for small angles:
    # front 0.85 * 1.2 * 7.0 = 7.14, rear 0.9 * 1.2 * 8.5 = 9.18: K = 0.003174 s^2.
    car = make_engine("single_track", parameters={**DIRECT, **AT_CG, "drive_force": 10})
    steering = steering_command(torch.tensor(0.01), car.values)
    # Throttle -0.6 is a drive of 0.2 and settles near 2 m/s.
    _, velocity = drive(car, held(-0.6, float(steering), 6.0), (2.0, 0.0, 0.0))
    vx, _, yaw_rate = velocity[-1].tolist()
    assert yaw_rate == pytest.approx(vx * 0.01 / (0.174 + 0.003174 * vx**2), rel=3e-3)


def test_a_crawling_car_turns_as_the_kinematic_one():
    parameters = {**DIRECT, **AT_CG, **FREE}
    _, velocity = drive(
        make_engine("single_track", parameters=parameters), held(-1, 1, 0.5), (0.2, 0, 0)
    )
    vx, vy, yaw_rate = velocity[-1].tolist()
    angle = float(road_wheel_angle(torch.tensor(1.0), make_engine("single_track").values))
    assert vx > 0.1  # it still rolls
    assert yaw_rate == pytest.approx(vx * math.tan(angle) / 0.174, rel=0.01)
    assert vy == pytest.approx(0.093 * yaw_rate, rel=0.01)


def test_a_tyre_never_pushes_harder_than_its_grip():
    car = make_engine("single_track", 5, parameters={**DIRECT, **AT_CG, "front_drive_share": 0})
    steering = torch.linspace(-1, 1, 5)
    actions = torch.stack([torch.ones(5), steering], -1).unsqueeze(1).expand(5, 400, 2)
    _, velocity = drive(car, actions)
    rate = velocity.diff(dim=1) / 0.01
    lateral = rate[..., 1] + velocity[:, 1:, 0] * velocity[:, 1:, 2]  # ay = dvy + vx r
    assert lateral.abs().max() > 0.7 * GRAVITY  # the tyres are at their limit
    assert lateral.abs().max() <= 0.9 * GRAVITY * 1.03  # finite differences over 10 ms


def test_coasting_never_gains_energy():
    torch.manual_seed(0)
    for preset in ("buggy", "dart"):
        car = make_engine("single_track", 512, preset=preset)
        velocity = (torch.rand(512, 3) - 0.5) * torch.tensor([24.0, 6.0, 20.0])
        steering = torch.rand(512, 1, 1) * 2 - 1
        actions = torch.cat([-torch.ones(512, 1, 1), steering], -1).expand(512, 200, 2)
        actions = torch.cat([actions, actions], 1)
        _, velocity = drive(car, actions, velocity)
        # Until the throttle that the reset assumed has passed through, there is still drive.
        x, y = car.values["sensor_x"], car.values["sensor_y"]
        vx, vy, yaw_rate = shift_velocity(velocity[:, 100:], -x, -y).unbind(-1)
        mass, inertia = car.values["mass"], car.values["yaw_inertia"]
        energy = 0.5 * mass * (vx**2 + vy**2) + 0.5 * inertia * yaw_rate**2  # J
        assert energy[:, 0].max() > 1.0
        assert (energy.diff(dim=1) <= 1e-5 * energy[:, :-1] + 1e-9).all()


def test_resistance_is_never_a_push():
    # DART's c v + d v^2 + 1.27 turns negative above 8 m/s.
    values = make_engine("single_track", preset="dart").values
    vx = torch.linspace(-15, 15, 301)
    force = resistance(vx, torch.tensor(0.0), values)
    assert (force * vx >= 0).all()
    assert (force[vx.abs() > 8.5] == 0).all()
    assert float(resistance(torch.tensor(2.0), torch.tensor(0.0), values)) == pytest.approx(
        1.266 + 0.7393 * 2 - 0.11232 * 4 - (3.9412 + 1.3381 * 2) * 0.019991, rel=1e-4
    )


def slalom(substeps):
    car = make_engine("single_track", 4, parameters=DIRECT, substeps=substeps)
    time = torch.arange(60) * 0.01
    steering = torch.sin(torch.tensor([3.0, 6.0, 9.0, 12.0])[:, None] * time)
    throttle = torch.tensor([-0.8, -0.5, 0.0, 1.0])[:, None].expand(4, 60)
    return drive(car, torch.stack([throttle, steering], -1), (1.5, 0.0, 0.0))[0]


def test_halving_the_timestep_changes_one_second_paths_by_under_a_percent():
    coarse, fine = slalom(2), slalom(4)
    length = fine[..., :2].diff(dim=1).norm(dim=-1).sum(-1)
    assert ((coarse - fine)[:, -1, :2].norm(dim=-1) < 0.01 * length).all()


@pytest.mark.slow
def test_the_integration_is_of_second_order():
    exact = slalom(32)
    error = [(slalom(n) - exact)[..., :2].norm(dim=-1).max() for n in (2, 4, 8)]
    # second order: a quarter of the error for half the step
    assert error[0] / error[1] > 2.8
    assert error[1] / error[2] > 2.8


def test_the_stiffest_tyres_stay_calm_at_rest_and_at_a_crawl():
    most = {"grip": 3.0, "shape": 1.5, "stiffness": 60.0}
    tyres = {f"{axle}_{what}": most[what] for axle in ("front", "rear") for what in most}
    parameters = {**DIRECT, **AT_CG, **tyres, "yaw_inertia": 5e-4}
    car = make_engine("single_track", 3, parameters=parameters)
    start = torch.tensor([[0.0, 0.0, 0.0], [0.05, 0.0, 0.0], [0.5, 0.3, 3.0]])
    _, velocity = drive(car, held(-1, 1, 1.0), start)
    at_rest, crawling, thrown = velocity
    assert (at_rest == 0).all()
    assert ((crawling[:, 2] >= 0) & (crawling[:, 2] < 0.2)).all()  # no chatter
    energy = 1.625 * thrown[:, :2].square().sum(-1) + 5e-4 * thrown[:, 2].square()  # twice, J
    assert (energy <= energy[0]).all()
    assert energy[-1] < 0.03 * energy[0]


def test_slip_is_taken_against_the_true_speed_unless_the_car_nearly_stands():
    v = torch.tensor([-2.0, -SLIP_SPEED, 0.0, SLIP_SPEED, 2.0])
    torch.testing.assert_close(
        rolling_speed(v), torch.tensor([2.0, SLIP_SPEED, SLIP_SPEED / 2, SLIP_SPEED, 2.0])
    )


def test_dart_steers_as_published():
    values = make_engine("single_track", preset="dart").values
    angle = road_wheel_angle(torch.tensor([1.0, 0.0, -1.0]), values)
    torch.testing.assert_close(angle, torch.tensor([0.320, -0.014, -0.403]), atol=6e-4, rtol=0)


def test_steering_command_undoes_the_steering_map():
    values = make_engine("single_track", preset="dart").values
    command = torch.tensor([-0.9, -0.5, -0.2, 0.2, 0.5, 0.9])  # away from the blended middle
    back = steering_command(road_wheel_angle(command, values), values)
    torch.testing.assert_close(back, command, atol=2e-3, rtol=0)


def test_dart_reaches_the_speed_where_motor_and_resistance_balance():
    # (25.358 - 4.8153 v) 0.83622 = 1.266 + 0.7393 v - 0.11232 v^2 - 0.019991 (3.9412 + 1.3381 v)
    # 0.11232 v^2 - 4.73920 v + 20.01768 = 0 -> v = 4.7620 m/s
    car = make_engine("single_track", preset="dart", parameters={"steering_offset": 0, **AT_CG})
    _, velocity = drive(car, held(1, 0, 8.0))
    assert float(velocity[-1, 0]) == pytest.approx(4.762, abs=2e-3)


def test_it_pulls_away_with_the_motor_force_over_the_mass():
    # 10 N (1 - 0.05) / 1.625 kg = 5.846 m/s^2; friction builds up from rest and is switched off.
    car = make_engine("single_track", parameters={**DIRECT, **FREE, "drive_force": 10})
    _, velocity = drive(car, held(1, 0, 0.01))
    assert float(velocity[-1, 0]) == pytest.approx(0.05846, rel=0.01)


def test_a_dead_time_between_two_periods_shares_the_command_between_them():
    weights = dead_time_weights(torch.tensor([0.0, 0.02, 0.025]), 0.01, 5)
    expected = [[1, 0, 0, 0, 0], [0, 0, 1, 0, 0], [0, 0, 0.5, 0.5, 0]]
    torch.testing.assert_close(weights, torch.tensor(expected))


def test_a_command_acts_after_its_dead_time():
    car = make_engine("single_track", parameters={**DIRECT, "steering_dead_time": 0.025})
    state = car.reset()
    heard = []
    for _ in range(5):
        state[keys.ACTION] = torch.tensor([-1.0, 0.8])
        state = car._step_mdp(car.step(state))
        heard.append(round(float(state[ACTUATOR][1]), 5))
    assert heard == [0.0, 0.0, 0.4, 0.8, 0.8]


def test_a_lag_has_gone_63_percent_after_its_time_constant():
    car = make_engine("single_track", parameters={**DIRECT, "throttle_lag": 0.1})
    state = car.reset()
    for _ in range(10):
        state[keys.ACTION] = torch.tensor([1.0, 0.0])
        state = car._step_mdp(car.step(state))
    assert float(state[ACTUATOR][0]) == pytest.approx(-1 + 2 * (1 - math.exp(-1)), rel=1e-5)


def test_no_lag_is_followed_at_once_and_a_long_one_hardly():
    decay = mean_lag_decay(torch.tensor([0.0, 1e9]), 0.0, 0.005)
    torch.testing.assert_close(decay, torch.tensor([0.0, 1.0]), atol=1e-3, rtol=0)


@pytest.mark.parametrize(
    "name",
    [
        "steering_dead_time",
        "front_stiffness",
        *(pytest.param(n, marks=pytest.mark.slow) for n in ("steering_lag", "mass")),
    ],
)
def test_the_path_has_the_gradient_that_differences_show(name):
    actions = torch.stack([torch.full((60,), 0.2), torch.sin(torch.arange(60) / 6.0)], -1)

    def end(value):
        car = make_engine("single_track").with_parameters(TensorDict({name: value}))
        return drive(car, actions, (2.0, 0.0, 0.0))[0][-1, 1]

    # Halfway between two periods, where the path is smooth in the dead time.
    value = 0.035 if "time" in name else float(make_engine("single_track").values[name])
    value = torch.tensor(value, requires_grad=True)
    with torch.enable_grad():
        (slope,) = torch.autograd.grad(end(value), value)
    h = 0.02 * float(value.detach())
    with torch.no_grad():
        difference = (end(value + h) - end(value - h)) / (2 * h)
    assert abs(float(slope)) > 1e-4
    assert float(slope) == pytest.approx(float(difference), rel=0.03)


def test_the_path_is_continuous_in_the_dead_time():
    times = torch.linspace(0.0, 0.12, 49)
    car = make_engine("single_track").with_parameters(
        TensorDict({"steering_dead_time": times}, batch_size=[49])
    )
    actions = torch.stack([torch.zeros(80), torch.sin(torch.arange(80) / 8.0)], -1)
    y = drive(car, actions, (2.0, 0.0, 0.0))[0][:, -1, 1]
    steps = y.diff().abs()
    assert steps.max() < 4 * steps.mean()
    assert (y.max() - y.min()) > 0.05  # m: dead time matters


def test_every_car_of_a_batch_may_have_its_own_parameters():
    masses = torch.tensor([1.2, 1.6, 2.4])
    dead_times = torch.tensor([0.0, 0.033, 0.2])
    car = make_engine("single_track").with_parameters(
        TensorDict({"mass": masses, "steering_dead_time": dead_times}, batch_size=[3])
    )
    actions = held(0.5, 0.6, 0.5)
    together = drive(car, actions)[0]
    for i in range(3):
        own = {"mass": float(masses[i]), "steering_dead_time": float(dead_times[i])}
        alone = drive(make_engine("single_track", parameters=own), actions)[0]
        torch.testing.assert_close(together[i], alone, atol=1e-5, rtol=1e-5)


def test_the_sensor_reports_its_own_point_of_the_same_motion():
    actions = torch.stack([torch.full((100,), 0.3), torch.sin(torch.arange(100) / 10.0)], -1)
    at_cg = make_engine("single_track", parameters=AT_CG)
    ahead = make_engine("single_track", parameters={"sensor_x": 0.1, "sensor_y": 0.03})
    pose, velocity = drive(at_cg, actions)
    seen_pose, seen_velocity = drive(ahead, actions)
    origin = seen_pose[0] - shift_pose(pose, 0.1, 0.03)[0]
    torch.testing.assert_close(
        shift_velocity(velocity, 0.1, 0.03), seen_velocity, atol=1e-4, rtol=0
    )
    torch.testing.assert_close(shift_pose(pose, 0.1, 0.03) + origin, seen_pose, atol=1e-3, rtol=0)


def test_a_car_set_down_in_motion_is_taken_to_be_driving_steadily():
    # Its unknown past commands are those that hold it: nothing is lost in the dead time.
    late = {"throttle_dead_time": 0.2, "steering_dead_time": 0.2}
    car = make_engine("single_track", preset="dart", parameters=late)
    _, velocity = drive(car, held(-1, 0, 0.2), (2.0, 0.0, 0.0))
    assert float(velocity[-1, 0]) == pytest.approx(2.0, abs=0.02)
    _, velocity = drive(car, held(-1, 0, 0.2), (1.5, 0.05, 2.0))
    assert float(velocity[-1, 2]) == pytest.approx(2.0, abs=0.25)  # slip is left out


def test_a_preset_is_also_a_simulator_file():
    folder = Path(buggy_rl.simulators.__file__).parent / "presets"
    files = sorted(folder.glob("*.yaml"))
    assert [file.stem for file in files] == ["buggy", "dart", "dart_lag"]
    for file in files:
        from_file, by_name = make_engine(file), make_engine("single_track", preset=file.stem)
        assert {n: float(v) for n, v in from_file.values.items()} == {
            n: float(v) for n, v in by_name.values.items()
        }


def test_an_unknown_preset_is_refused_with_the_known_ones():
    with pytest.raises(ValueError, match="'kart'; available: buggy, dart, dart_lag"):
        make_engine("single_track", preset="kart")


def test_a_dead_time_longer_than_the_memory_is_refused():
    with pytest.raises(ValueError, match=r"outside 0\.\.0\.25 s"):
        make_engine("single_track").with_parameters(
            TensorDict({"throttle_dead_time": torch.tensor(0.3)})
        )


def test_no_substeps_are_refused():
    with pytest.raises(ValueError, match="substeps is 0"):
        make_engine("single_track", substeps=0)


def test_no_bit_of_a_steering_command_depends_on_how_many_cars_there_are():
    angle = 0.6 * torch.rand(4096, generator=torch.Generator().manual_seed(0)) - 0.3
    values = make_engine("single_track").values
    together = steering_command(angle, values)
    for first, last in ((0, 16), (48, 96), (5, 4096)):
        assert torch.equal(together[first:last], steering_command(angle[first:last], values))
