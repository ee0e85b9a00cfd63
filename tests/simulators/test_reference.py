import math

import pytest
import torch
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.core.kernels import FOLDER
from buggy_rl.core.vehicle import GRAVITY, rotate, shift_velocity
from buggy_rl.simulators.reference import ReferenceEngine
from buggy_rl.simulators.reference.parameters import DIMENSIONS
from buggy_rl.simulators.reference.state import CHARGE, DUTY, LEAN, SERVO, TYRE_SLIP, WHEEL_SLIP
from tests.simulators.reference_drives import SYMMETRIC, drive, held, start, varied


@pytest.fixture
def exact(monkeypatch):
    """By PyTorch alone, where a batch is compared with what has no kernel."""
    monkeypatch.setenv(FOLDER, "")


@pytest.fixture(scope="module")
def launch():
    return drive(ReferenceEngine(2, parameters=SYMMETRIC), start(torch.zeros(2, 3)), held(1, 0, 8))


def test_a_car_alone_without_a_batch_hands_its_kernel_all_that_it_reads(exact, packaged):
    def drive_alone():
        return drive(ReferenceEngine(()), start([1.0, 0.0, 0.0]), held(0.2, 0.5, 0.2))

    expected = drive_alone()
    packaged()
    torch.testing.assert_close(drive_alone()[keys.VELOCITY], expected[keys.VELOCITY])


def test_full_throttle_on_a_straight_ends_between_8_and_10_metres_a_second(launch):
    vx, vy, yaw_rate = launch[keys.VELOCITY][:, 0].unbind(-1)
    assert 8.0 < vx[-1] < 10.0
    assert vx[-1] - vx[-100] < 0.15  # has settled
    assert vy.abs().max() < 1e-3
    assert yaw_rate.abs().max() < 1e-3


def test_full_throttle_from_rest_spins_the_rear_wheels_only_and_not_for_long(launch):
    front, rear = launch[WHEEL_SLIP][:, 0, :2], launch[WHEEL_SLIP][:, 0, 2:]
    assert rear[:60].max() > 0.5  # [m/s]
    assert rear[200:].max() < 0.4
    assert front.abs().max() < 0.05


def test_acceleration_never_exceeds_what_the_rear_tyres_can_hold(launch):
    # The rear axle carries m g (a / L + h / L x), so x = mu (a + h x) / L in units of g.
    car = ReferenceEngine().values
    peak = car["grip"] * car["cg_to_front_axle"]
    peak = peak / (DIMENSIONS.wheelbase - car["grip"] * car["cg_height"])
    acceleration = launch[keys.VELOCITY][:, 0, 0].diff() / 0.01
    assert acceleration.max() < 1.05 * peak * GRAVITY  # 5 %: the body bounces on its springs
    assert acceleration.max() > 0.7 * peak * GRAVITY


def test_a_car_at_rest_without_drive_stays_at_rest_however_it_is_steered():
    for_ever = torch.stack([torch.full((100,), -1.0), torch.sin(torch.arange(100) * 0.1)], -1)
    states = drive(ReferenceEngine(2), start(torch.zeros(2, 3)), for_ever)
    assert torch.equal(states[keys.VELOCITY], torch.zeros(101, 2, 3))
    assert torch.equal(states[keys.POSE], torch.zeros(101, 2, 3))


def test_a_car_that_rolls_out_stops_and_stays():
    states = drive(ReferenceEngine(2), start([[1.0, 0.0, 0.0]] * 2), held(-1, 0.3, 4))
    assert states[keys.VELOCITY][-100:].abs().max() < 1e-5
    assert torch.allclose(states[keys.POSE][-1], states[keys.POSE][-100], atol=1e-5)


def test_coasting_loses_energy_but_for_what_the_tyres_spring_back():
    engine = ReferenceEngine(64)
    state, actions = varied(64, 2)
    actions[..., 0] = -1.0
    states = drive(engine, state, actions)
    velocity = shift_velocity(states[keys.VELOCITY], -DIMENSIONS.sensor_to_cg)
    body = engine.values["mass"] * velocity[..., :2].square().sum(-1)
    energy = 0.5 * (body + engine.values["yaw_inertia"] * velocity[..., 2].square())
    # A carcass strained by s L under the force c F_z s holds at most c F_z L s^2 / 2.
    slip = states[TYRE_SLIP].movedim((-2, -1), (0, 1))  # (2, 4, T + 1, 64)
    spring = (engine.car.tyres.stiffness.unsqueeze(-1) * slip.square()).sum(0)
    spring = 0.5 * engine.values["relaxation_length"] * spring
    stored = (spring * engine.car.chassis.static_load.unsqueeze(-1)).sum(0)
    growth = energy.diff(dim=0)
    assert (growth < stored[:-1] + 1e-6).all()
    moving = torch.linalg.vector_norm(velocity[:-1, :, :2], dim=-1) > 0.5
    assert (growth[moving] < 0).all()
    assert (energy[-1] < 0.8 * energy[0] + 1e-6).all()


def test_mirrored_steering_mirrors_the_drive():
    engine = ReferenceEngine(32, parameters=SYMMETRIC)
    state, actions = varied(32, 1)
    flip = torch.tensor([1.0, -1.0, -1.0])
    plain = drive(engine, state, actions)
    mirrored = drive(engine, start(state[keys.VELOCITY] * flip), actions * flip[:2])
    for key in (keys.POSE, keys.VELOCITY):
        torch.testing.assert_close(mirrored[key], plain[key] * flip, atol=1e-4, rtol=1e-4)


def test_the_shipped_car_is_not_mirror_symmetric():
    actions = torch.stack([held(-0.3, 1.0, 2.5), held(-0.3, -1.0, 2.5)], 1)
    yaw_rate = drive(ReferenceEngine(2), start(torch.zeros(2, 3)), actions)[keys.VELOCITY][-1, :, 2]
    assert yaw_rate[0] > 0 > yaw_rate[1]
    assert -yaw_rate[1] > 1.02 * yaw_rate[0]  # more lock to the right


def test_where_and_in_which_direction_a_drive_starts_changes_nothing():
    engine = ReferenceEngine(32)
    state, actions = varied(32, 1)
    pose = torch.rand(32, 3, generator=torch.Generator().manual_seed(1)) * 6
    here = drive(engine, state, actions)
    there = drive(engine, start(state[keys.VELOCITY], pose), actions)
    torch.testing.assert_close(there[keys.VELOCITY], here[keys.VELOCITY], atol=1e-5, rtol=1e-5)
    moved = pose[:, :2] + rotate(here[keys.POSE][..., :2], pose[:, 2].expand(101, 32))
    torch.testing.assert_close(there[keys.POSE][..., :2], moved, atol=1e-4, rtol=1e-5)


def test_halving_the_substep_changes_paths_of_one_second_by_less_than_one_percent():
    state, actions = varied(128, 1)
    ends, length = [], 0.0
    for substep in (0.001, 0.0005):
        pose = drive(ReferenceEngine(128, substep=substep), state, actions)[keys.POSE][..., :2]
        length = torch.linalg.vector_norm(pose.diff(dim=0), dim=-1).sum(0)
        ends.append(pose[-1])
    change = torch.linalg.vector_norm(ends[0] - ends[1], dim=-1) / length.clamp_min(0.05)
    assert change.max() < 0.01
    assert change.mean() < 0.002


def test_any_state_within_twice_its_range_stays_finite_and_calms_down():
    engine, draw = ReferenceEngine(256), torch.Generator().manual_seed(0)
    state = engine.reset()
    ranges = {
        keys.VELOCITY: torch.tensor([7.0, 7.0, 13.0]),
        WHEEL_SLIP: 10.0,
        TYRE_SLIP: 2.0,
        LEAN: torch.tensor([[20.0], [600.0]]),
        SERVO: 2.0,
        DUTY: 2.0,
        CHARGE: 16000.0,
    }
    for key, span in ranges.items():
        state[key] = (2 * torch.rand(state[key].shape, generator=draw) - 1) * span
    actions = 2 * torch.rand(100, 256, 2, generator=draw) - 1
    states = drive(engine, state, torch.cat([actions, torch.full_like(actions, -1.0)]))
    assert all(value.isfinite().all() for value in states.values())
    speed = torch.linalg.vector_norm(states[keys.VELOCITY][..., :2], dim=-1)
    assert speed.max() < 12.0
    assert speed[-1].max() < 8.0
    assert states[keys.VELOCITY][-1, :, 2].abs().max() < 13.0


def test_an_edited_speed_takes_the_wheels_with_it():
    engine = ReferenceEngine(1, parameters=SYMMETRIC)
    rolling = drive(engine, start([[2.0, 0.0, 0.0]]), held(-1, 0, 0.2))[-1]
    edited = rolling.clone()
    edited[keys.VELOCITY] = rolling[keys.VELOCITY] + torch.tensor([1.0, 0.0, 0.0])
    after = drive(engine, edited, held(-1, 0, 0.1))[keys.VELOCITY][:, 0, 0]
    # Coasting at 3 m/s costs some 1.5 m/s^2; wheels still turning for 2 m/s would brake with 8.
    assert after[0] - after[-1] < 0.2
    assert after[0] - after[-1] > 0.05


def test_an_edited_pose_moves_the_car_and_nothing_else():
    engine = ReferenceEngine(1)
    state = drive(engine, start([[2.0, 0.1, 0.5]]), held(0, 0.5, 0.1))[-1]
    moved = state.clone()
    moved[keys.POSE] = state[keys.POSE] + torch.tensor([10.0, -5.0, 0.0])
    one, two = (drive(engine, s, held(0, 0.5, 0.05))[-1] for s in (state, moved))
    torch.testing.assert_close(two[keys.POSE] - one[keys.POSE], moved[keys.POSE] - state[keys.POSE])
    assert torch.equal(two[keys.VELOCITY], one[keys.VELOCITY])


def test_a_car_reset_in_the_middle_of_a_turn_goes_on_turning():
    engine = ReferenceEngine(2)
    actions = torch.stack([held(-0.2, 0.6, 3), held(-0.3, -0.8, 3)], 1)
    steady = drive(engine, start(torch.zeros(2, 3)), actions)[-1]
    again = engine.reset(start(steady[keys.VELOCITY], steady[keys.POSE]), set_state=True)
    torch.testing.assert_close(again[SERVO], steady[SERVO], atol=0.12, rtol=0)
    after = drive(engine, again, actions[:5])[-1]
    torch.testing.assert_close(after[keys.VELOCITY], steady[keys.VELOCITY], atol=0.15, rtol=0.05)


def test_slow_turns_have_the_radius_of_the_steering_angle():
    engine = ReferenceEngine(2, parameters=SYMMETRIC | {"ackermann": 1.0})
    actions = torch.stack([held(-0.45, 1.0, 4), held(-0.5, 0.5, 4)], 1)
    velocity = drive(engine, start(torch.zeros(2, 3)), actions)[keys.VELOCITY][-1]
    at_rear = shift_velocity(velocity, -DIMENSIONS.sensor_to_cg - 0.093)  # a = 81, L = 174 mm
    radius = at_rear[:, 0] / at_rear[:, 2]
    # Rear axle: R = L / tan(delta), 0.174 / tan(0.36) = 0.462 m and 0.174 / tan(0.18) = 0.956 m.
    torch.testing.assert_close(radius, torch.tensor([0.462, 0.956]), atol=0, rtol=0.03)


def test_fast_turns_are_limited_by_grip_and_understeer():
    throttle = torch.linspace(-0.5, 0.3, 8)
    actions = torch.stack([throttle, torch.full((8,), 0.6)], -1).expand(400, 8, 2)
    states = drive(ReferenceEngine(8, parameters=SYMMETRIC), start(torch.zeros(8, 3)), actions)
    speed, _, yaw_rate = states[keys.VELOCITY][-1].unbind(-1)
    lateral = speed * yaw_rate
    grip = float(ReferenceEngine().values["grip"]) * GRAVITY
    assert (lateral < grip).all()
    assert lateral.max() > 0.7 * grip
    assert ((speed / yaw_rate).diff() > 0).all()  # the circle widens with speed


def test_an_emptier_battery_is_slower_and_driving_empties_it():
    values = TensorDict({"initial_charge": torch.tensor([1.0, 0.5, 0.1])}, [3])
    engine = ReferenceEngine(parameters=SYMMETRIC).with_parameters(values)
    states = drive(engine, start(torch.zeros(3, 3)), held(0.5, 0, 3))
    assert (states[keys.VELOCITY][-1, :, 0].diff() < -0.05).all()
    assert (states[CHARGE].diff(dim=0) > 0).all()
    voltage = engine.car.drivetrain.open_voltage(states[CHARGE][..., 0])
    assert (voltage[-1] < voltage[0]).all()


def test_the_steering_lags_by_its_servo_and_no_faster_than_its_rate():
    servo = drive(ReferenceEngine(1), start(torch.zeros(1, 3)), held(-1, 1, 0.5))[SERVO][:, 0, 0]
    # At 12 1/s until c - s = 12 * 0.055 = 0.66, that is 0.34 / 12 = 28 ms, and from then on
    # 1 - 0.66 e^(-t / 55 ms): 63 % after 28 + 55 ln(0.66 / 0.37) = 60 ms.
    time = 0.01 * float((servo < 0.632).sum())
    assert 0.06 <= time <= 0.07
    assert servo.diff().max() < 0.01 * 12.0 + 1e-6
    assert math.isclose(float(servo[-1]), 1.0, abs_tol=1e-3)


@pytest.mark.usefixtures("exact")
def test_each_car_of_a_batch_has_its_own_parameters():
    values = TensorDict(
        {"mass": torch.tensor([1.4, 2.2]), "lock_left": torch.tensor([0.3, 0.45])}, [2]
    )
    actions = held(-0.2, 0.7, 0.5)
    both = drive(ReferenceEngine().with_parameters(values), start(torch.zeros(2, 3)), actions)
    for index in range(2):
        own = {name: float(value[index]) for name, value in values.items()}
        alone = drive(ReferenceEngine(parameters=own), start(torch.zeros(3)), actions)
        torch.testing.assert_close(alone[keys.POSE], both[keys.POSE][:, index])


@torch.enable_grad()
def test_a_step_can_be_differentiated_from_rest_and_by_every_parameter():
    names = sorted(ReferenceEngine().declared)
    values = TensorDict(
        {n: torch.full((2,), p.value) for n, p in ReferenceEngine().declared.items()}, [2]
    )
    values.requires_grad_()
    engine = ReferenceEngine().with_parameters(values)
    state = start(torch.tensor([[0.0, 0.0, 0.0], [2.0, 0.1, 1.0]]))
    action = torch.tensor([[-0.3, 0.5], [-0.3, 0.5]], requires_grad=True)
    state = engine.reset(state, set_state=True)
    for _ in range(10):
        state = engine.step(state.set(keys.ACTION, action))["next"]
    wanted = [action, *(values[name] for name in names)]
    gradients = torch.autograd.grad(state[keys.VELOCITY].sum(), wanted, allow_unused=True)
    assert all(g is None or g.isfinite().all() for g in gradients)
    assert gradients[0].abs().min() > 0
    felt = {n for n, g in zip(names, gradients[1:], strict=True) if g is not None and g.any()}
    assert {"mass", "grip", "motor_constant", "lock_left", "relaxation_length"} <= felt


@pytest.mark.usefixtures("exact")
def test_batches_of_any_shape_step_alike():
    state, actions = varied(6, 0.2)
    flat = drive(ReferenceEngine(6), state, actions)
    square = drive(ReferenceEngine((2, 3)), state.reshape(2, 3), actions.reshape(-1, 2, 3, 2))
    for key, value in flat.items():
        torch.testing.assert_close(square[key].flatten(1, 2), value)
