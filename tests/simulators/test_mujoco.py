"""The batched MuJoCo engine as a car: physics as properties, beside the contract of all engines."""

import copy
import math
import pickle

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import check_env_specs

from buggy_rl.core import keys
from buggy_rl.core.vehicle import GRAVITY, VehicleDimensions
from buggy_rl.simulators.mujoco import MujocoEngine
from buggy_rl.simulators.mujoco.engine import PHYSICS_STATE
from buggy_rl.task.env import make_env
from tests.simulators.steps import follow, start, step

IDLE = {"rolling_resistance": 0.0, "viscous_drag": 0.0, "quadratic_drag": 0.0}
PROMPT = {"steering_lag": 0.0, "steering_dead_time": 0.0}


def excitation(cars, seconds=1.0, seed=0):
    """Starts [cars, 3] from rest to 3.5 m/s and actions [T, cars, 2] that change four times."""
    generator = torch.Generator().manual_seed(seed)
    velocity = torch.zeros(cars, 3)
    velocity[cars // 8 :, 0] = 3.5 * torch.rand(cars - cars // 8, generator=generator)
    throttle = 2.0 * torch.rand(4, cars, generator=generator) - 1.0
    steering = 2.0 * torch.rand(4, cars, generator=generator) - 1.0
    steps = round(seconds / 0.01)
    row = torch.arange(steps) * 4 // steps
    return velocity, torch.stack([throttle, steering], -1)[row]


def spread_over_headings(engine):
    """Relative spread of the turning radius of 8 cars that set off in 8 directions."""
    heading = torch.arange(8) * 2 * math.pi / 8 + 0.1
    state = start(engine, (1.5, 0.0, 0.0), torch.stack([0 * heading, 0 * heading, heading], -1))
    _, velocities, _ = follow(engine, state, [(-0.4, 0.6)] * 150)
    radius = velocities[50:, :, :2].norm(dim=-1) / velocities[50:, :, 2]  # (100, 8)
    assert 0.3 < radius[-1].mean() < 3.0  # m: it is a circle
    return float(((radius.amax(1) - radius.amin(1)) / radius.mean(1)).max())


@pytest.mark.parametrize("tyres", ["explicit", "contact"])
def test_turning_circles_do_not_depend_on_the_compass_heading(tyres):
    assert spread_over_headings(MujocoEngine(8, tyres=tyres)) < 1e-4


def test_with_a_pyramidal_cone_they_would():
    engine = MujocoEngine(8, tyres="contact")
    engine._cars._batch.expand("opt.cone")[:] = 0  # mjCONE_PYRAMIDAL: the test above can fail
    assert spread_over_headings(engine) > 1e-3


def test_around_one_circle_the_yaw_rate_stays_the_same():
    engine = MujocoEngine(parameters=IDLE)
    _, velocities, _ = follow(engine, start(engine, (1.5, 0.0, 0.0)), [(-0.55, 0.5)] * 1200)
    circle = velocities[-400:, 2]  # 4 s and more than once around
    assert circle.sum() * 0.01 > 2 * math.pi
    assert (circle.max() - circle.min()) / circle.mean() < 1e-3


def test_cornering_stiffness_does_not_change_with_speed():
    dimensions, speeds = VehicleDimensions(), torch.tensor([0.8, 1.2, 1.8, 2.6, 3.5])
    # A gentle turn without anything that brakes, so that it is all but steady.
    engine = MujocoEngine(5, parameters=IDLE | PROMPT)
    velocity = torch.stack([speeds, 0 * speeds, 0 * speeds], -1)
    _, velocities, _ = follow(engine, start(engine, velocity), [(-1.0, 0.05)] * 60)
    vx, vy, yaw_rate = velocities[-1].double().unbind(-1)
    # Rear axle: m a / L u r = C F_z tan(-alpha), F_z = m g a / L, so C = u r / (g tan(-alpha)).
    to_rear = dimensions.sensor_to_cg + dimensions.cg_to_rear_axle
    slip = -(vy - to_rear * yaw_rate) / vx
    stiffness = vx * yaw_rate / (GRAVITY * slip)
    torch.testing.assert_close(stiffness, torch.full_like(stiffness, 9.0), rtol=0.01, atol=0)


def test_a_parked_car_stays_where_it_is():
    engine = MujocoEngine(3)
    actions = torch.tensor([[-1.0, 0.0], [-1.0, 1.0], [-1.0, -0.4]])
    poses, velocities, _ = follow(engine, start(engine, (0.0, 0.0, 0.0)), [actions] * 500)
    assert poses[..., :2].norm(dim=-1).max() < 1e-3  # m in 5 s
    assert velocities.abs().max() < 1e-3


def test_slow_creeping_is_damped():
    engine = MujocoEngine(2)
    creep = torch.tensor([[0.0, 0.05, 0.0], [0.0, 0.0, 0.3]])
    poses, velocities, _ = follow(engine, start(engine, creep), [(-1.0, 0.0)] * 100)
    assert velocities[-1].abs().max() < 1e-3
    assert poses[-1].abs().max() < 0.02


def test_coasting_never_gains_energy():
    generator = torch.Generator().manual_seed(3)
    velocity = torch.randn(32, 3, generator=generator) * torch.tensor([2.0, 0.7, 3.0])
    engine = MujocoEngine(32, parameters=IDLE)
    state = start(engine, velocity)
    car, dimensions = engine.car, engine.car.dimensions

    def energy(state):
        vx, vy, yaw_rate = state[keys.VELOCITY].double().unbind(-1)
        spin = state[PHYSICS_STATE][:, car.model.nq + torch.as_tensor(car.spin)]  # (32, 4)
        inertia = torch.tensor([2.2e-5, 2.2e-5, 5.2e-5, 5.2e-5], dtype=torch.float64)
        vy = vy - dimensions.sensor_to_cg * yaw_rate  # at the centre of gravity
        moving = dimensions.mass * (vx**2 + vy**2) + dimensions.yaw_inertia * yaw_rate**2
        return 0.5 * (moving + (inertia * spin**2).sum(-1))

    # front wheels straight, so that nothing steers the car against the tyres
    energies = [energy(state)]
    for _ in range(150):
        state = step(engine, state, (-1.0, 0.0))
        energies.append(energy(state))
    energies = torch.stack(energies)
    # Body roll stores a little and gives it back: no more than 0.1 % of what there was at first.
    gained = energies.diff(dim=0).clamp_min(0).sum(0) / energies[0]
    assert gained.max() < 1e-3
    assert (energies[-1] < energies[0]).all()


@pytest.mark.parametrize("tyres", ["explicit", "contact"])
def test_mirrored_steering_mirrors_the_drive(tyres):
    engine = MujocoEngine(2, tyres=tyres)
    flip = torch.tensor([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0]])
    time = torch.arange(100) * 0.01
    actions = torch.stack([0.2 + 0 * time, torch.sin(6 * time)], -1)
    both = torch.stack([actions, actions * torch.tensor([1.0, -1.0])], 1)  # (100, 2, 2)
    state = start(engine, torch.tensor([1.0, 0.1, 0.5]) * flip)
    poses, velocities, _ = follow(engine, state, both)
    torch.testing.assert_close(poses[:, 1], poses[:, 0] * flip[1], atol=1e-5, rtol=0)
    torch.testing.assert_close(velocities[:, 1], velocities[:, 0] * flip[1], atol=1e-4, rtol=0)
    assert velocities[:, 0, 2].abs().max() > 1.0  # rad/s: it did turn


def test_halving_the_timestep_changes_one_second_paths_by_less_than_one_percent():
    velocity, actions = excitation(64)

    def drive(timestep):
        engine = MujocoEngine(64, timestep=timestep)
        return follow(engine, start(engine, velocity), actions)[0]

    default = MujocoEngine().car.timestep
    poses, finer = drive(default), drive(default / 2)
    length = finer[..., :2].diff(dim=0).norm(dim=-1).sum(0)
    moved = length > 0.1  # m
    error = (poses - finer)[-1, :, :2].norm(dim=-1) / length
    assert moved.sum() > 50
    assert error[moved].max() < 0.01
    assert error[moved].max() > 1e-5  # the two did differ


def test_top_speed_is_where_the_motor_meets_the_resistance():
    engine = MujocoEngine()
    _, velocities, _ = follow(engine, start(engine, (3.0, 0.0, 0.0)), [(1.0, 0.0)] * 500)
    # Resistance at 4.2 m/s: 0.8 + 0.4 * 4.2 + 0.02 * 4.2^2 = 2.83 N. Rear load 7.42 N, so the
    # slip ratio is 2.83 / (12 * 7.42) = 0.032. Motor: 18 - 3.5 * 1.032 v = 0.8 + 0.4 v + 0.02 v^2
    # gives v = (-4.012 + sqrt(4.012^2 + 4 * 0.02 * 17.2)) / 0.04 = 4.2 m/s.
    assert float(velocities[-1, 0]) == pytest.approx(4.2, rel=0.01)


def test_the_car_answers_a_dead_time_and_a_lag_after_the_command():
    late = {"steering_dead_time": 0.1, "steering_lag": 0.0}
    engine = MujocoEngine(parameters=late)
    _, velocities, _ = follow(engine, start(engine, (2.0, 0.0, 0.0)), [(-1.0, 1.0)] * 15)
    yaw_rate = velocities[:, 2]
    assert yaw_rate[:10].abs().max() < 1e-3
    assert yaw_rate[10] > 0.1


def test_an_edit_of_the_velocity_takes_the_wheels_along():
    engine = MujocoEngine()
    _, _, state = follow(engine, start(engine, (1.0, 0.0, 0.0)), [(-0.5, 0.0)] * 20)
    edited = state.clone().set(keys.VELOCITY, torch.tensor([3.0, 0.0, 0.0]))
    after = step(engine, edited, (-1.0, 0.0))
    # Wheels left at 1 m/s would brake with mu g = 9 m/s^2: 0.09 m/s in 10 ms.
    assert float(after[keys.VELOCITY][0]) == pytest.approx(3.0, abs=0.04)
    spin = after[PHYSICS_STATE][engine.car.model.nq + torch.as_tensor(engine.car.spin)]
    torch.testing.assert_close(spin, torch.full_like(spin, 3.0 / 0.0325), rtol=0.03, atol=0)


@pytest.mark.parametrize("batch_size", [(), (4,)])
def test_contact_tyres_keep_the_specs_too(batch_size):
    check_env_specs(MujocoEngine(batch_size, tyres="contact"))


def test_contact_tyres_drive_straight_ahead():
    engine = MujocoEngine(tyres="contact")
    poses, velocities, _ = follow(engine, engine.reset(), [(-0.4, 0.0)] * 200)
    assert poses[-1, 0] > 2.0  # m
    assert poses[:, 1:].abs().max() < 1e-4
    assert velocities[-1, 0] > 1.5


@pytest.mark.parametrize("tyres", ["explicit", "contact"])
def test_two_steps_from_one_state_are_equal_to_the_last_bit(tyres):
    engine = MujocoEngine(4, tyres=tyres)
    velocity, actions = excitation(4, seconds=0.2)
    _, _, state = follow(engine, start(engine, velocity), actions)
    first = step(engine, state, (0.3, 0.7))
    follow(engine, first, actions)  # other cars' states pass through the same memory
    second = step(engine, state, (0.3, 0.7))
    for key in engine.state_spec:
        assert torch.equal(first[key], second[key]), key


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_of_a_task_over_it_drives_to_the_same_bits(copied):
    env = make_env("mujoco", batch_size=2)
    state, other = env.reset(), copied(env)
    action = torch.tensor([[0.3, 0.7], [-0.2, -0.5]])
    for _ in range(3):
        one, two = (each.step(state.clone().set(keys.ACTION, action)) for each in (env, other))
        assert (one == two).all()
        state = one["next"]
    assert other.base_env.nthread == env.base_env.nthread


def test_the_number_of_threads_does_not_matter():
    velocity, actions = excitation(16, seconds=0.3)
    one, two = MujocoEngine(16), MujocoEngine(16, nthread=2)
    _, _, state = follow(one, start(one, velocity), actions)
    _, _, other = follow(two, start(two, velocity), actions)
    assert torch.equal(state[PHYSICS_STATE], other[PHYSICS_STATE])


@pytest.mark.parametrize("tyres", ["explicit", "contact"])
def test_parameters_per_car_drive_as_engines_of_their_own(tyres):
    values = TensorDict(
        {
            "mass": torch.tensor([1.4, 1.625, 2.2]),
            "yaw_inertia": torch.tensor([0.004, 0.006, 0.008]),
            "cg_to_front_axle": torch.tensor([0.075, 0.081, 0.1]),
            "grip_front": torch.tensor([0.6, 0.9, 1.2]),
            "steering_dead_time": torch.tensor([0.0, 0.033, 0.19]),
            "throttle_lag": torch.tensor([0.0, 0.05, 0.21]),
            "drive_force": torch.tensor([10.0, 18.0, 30.0]),
        },
        batch_size=[3],
    )
    engine = MujocoEngine(tyres=tyres).with_parameters(values)
    actions = excitation(1, seconds=0.6)[1].expand(-1, 3, -1)
    poses, velocities, _ = follow(engine, start(engine, (1.5, 0.0, 0.0)), actions)
    for car in range(3):
        own = MujocoEngine(parameters={n: float(v[car]) for n, v in values.items()}, tyres=tyres)
        pose, velocity, _ = follow(own, start(own, (1.5, 0.0, 0.0)), actions[:, 0])
        torch.testing.assert_close(poses[:, car], pose, atol=1e-6, rtol=1e-6)
        torch.testing.assert_close(velocities[:, car], velocity, atol=1e-5, rtol=1e-5)
    assert (poses[-1, 0] - poses[-1, 2]).norm() > 0.05  # m: the cars do differ


def test_with_parameters_keeps_what_was_set_before():
    engine = MujocoEngine(parameters={"drive_force": 30.0})
    changed = engine.with_parameters(TensorDict({"mass": torch.tensor([1.6, 2.0])}, batch_size=[2]))
    assert float(changed.values["drive_force"]) == 30.0
    assert changed.declared["drive_force"].value == 30.0
    assert changed.batch_size == (2,)


def test_a_state_beyond_the_physics_is_reported_and_does_not_linger():
    engine = MujocoEngine(2)
    state = start(engine, (1.0, 0.0, 0.0))
    broken = state.clone()
    broken[keys.VELOCITY][1, 0] = float("nan")
    with pytest.raises(RuntimeError, match="in environment 1"):
        step(engine, broken, (0.0, 0.0))
    assert step(engine, state, (0.0, 0.0))[keys.VELOCITY].isfinite().all()


def test_a_trial_beyond_the_physics_is_lost_alone():
    engine = MujocoEngine(2)
    engine.lost_as_nan = True
    state = start(engine, (1.0, 0.0, 0.0))
    broken = state.clone()
    broken[keys.VELOCITY][1, 0] = float("nan")
    whole = state
    for _ in range(3):
        broken, whole = (step(engine, each, (0.3, 0.2)) for each in (broken, whole))
        assert torch.equal(broken[keys.VELOCITY][0], whole[keys.VELOCITY][0])
        assert broken[keys.POSE][1].isnan().all()
        assert broken[keys.VELOCITY][1].isnan().all()


@pytest.mark.parametrize("timestep", [0.003, 0.02])
def test_a_timestep_that_does_not_divide_the_control_period_is_refused(timestep):
    with pytest.raises(ValueError, match=r"does not divide the control period of 0\.01 s"):
        MujocoEngine(timestep=timestep)
