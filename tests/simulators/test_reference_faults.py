"""What is said of faults in general; what each one does is in `test_reference_fault_*`."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import check_env_specs

from buggy_rl.core import keys
from buggy_rl.simulators import make_engine
from buggy_rl.simulators.reference import ReferenceEngine
from buggy_rl.simulators.reference.faults import FAULTS, NEUTRAL, OF_A_COMMAND, Faults
from buggy_rl.simulators.reference.state import CHARGE, HEAT, LINE, RACK
from tests.simulators.reference_drives import drive, held, start, varied

# Each fault by itself, at a size that is felt within a second; a patch needs all of its numbers.
FELT = {
    "throttle_dead_time.dead_time": 0.063,
    "steering_dead_time.dead_time": 0.117,
    "throttle_offset.offset": 0.1,
    "steering_offset.offset": -0.1,
    "steering_lag.time_constant": 0.1,
    "steering_rate_limit.rate": 3.0,
    "steering_gain.gain": 0.8,
    "steering_backlash.width": 0.2,
    "steering_asymmetry.left_to_right": 0.8,
    "servo_stiction.width": 0.3,
    "steering_dead_zone.width": 0.15,
    "steering_curve.curvature": 0.5,
    "steering_end_stop.left_cut": 0.7,
    "steering_end_stop.right_cut": 0.7,
    "steering_play.width": 0.3,
    "voltage_sag.resistance_ratio": 0.8,
    "thermal_foldback.foldback": 0.8,
    "brown_out.moving": 0.9,
    "brown_out.holding": 0.5,
    "gear_ratio.ratio": 1.4,
    "sticky_servo.breakaway": 0.3,
    "bump_steer.angle": 0.01,
    "wheel_wobble.angle": 0.1,
    "throttle_lag.time_constant": 0.15,
    "throttle_gain.gain": 0.8,
    "throttle_deadband.width": 0.1,
    "battery_sag.loss_per_minute": 0.5,
    "motor_power_limit.power_per_mass": 3.0,
    "top_speed.speed_ratio": 0.6,
    "drag_brake.share": 0.5,
    "heating_motor.rise": 0.02,
    "loose_differential.time_constant": 0.2,
    "rolling_resistance.deceleration": 0.4,
    "viscous_drag.rate": 0.3,
    "cornering_drag.coefficient": 0.04,
    "steering_drag.per_angle": 3.0,
    "torque_steer.offset": 0.01,
    "stiff_differential.coupling": 0.7,
    "understeer.gradient": 0.01,
    "dive_steer.angle": 0.01,
    "cornering_stiffness.ratio": 0.6,
    "one_sided_drag.yaw_acceleration": 10.0,
    "tire_grip.grip": 0.6,
    "grip_balance.front_to_rear": 0.7,
    "grip_patch.grip": 0.4,
    "payload.mass_ratio": 1.4,
    "aerodynamic_drag.coefficient": 0.1,
    "wind.force_x": 0.4,
    "wind.force_y": -0.4,
    "floor_slope.along_x": 0.4,
    "floor_slope.along_y": -0.4,
    "yaw_damping.rate": 6.0,
}
BESIDE = {
    "grip_patch.grip": {"grip_patch.radius": 5.0},
    "thermal_foldback.foldback": {"thermal_foldback.time_constant": 1.0},
}


def one_each():
    """Faults [2 N]: every other car has one of them, the cars between have none."""
    faults = TensorDict(batch_size=[2 * len(FELT)])
    for index, (name, value) in enumerate(FELT.items()):
        for own, size in ({name: value} | BESIDE.get(name, {})).items():
            faults[own] = torch.full((2 * len(FELT),), NEUTRAL[own])
            faults[own][2 * index] = size
    return faults


# There are kernels of cars without faults alone, and to the last bit they are not PyTorch.
pytestmark = pytest.mark.usefixtures("without_kernels")


@pytest.fixture(scope="module")
def commanded():
    state, actions = varied(2 * len(FELT), 1.0, seed=6)
    pairs = state[::2].repeat_interleave(2, 0)  # both cars of a pair do the same
    return pairs, actions[:, ::2].repeat_interleave(2, 1)


@pytest.fixture(scope="module")
def sound(commanded):
    return drive(ReferenceEngine(2 * len(FELT)), *commanded)


@pytest.fixture(scope="module")
def faulty(commanded):
    return drive(ReferenceEngine().with_faults(one_each()), *commanded)


def test_every_fault_is_tried_here():
    places = {"grip_patch.x", "grip_patch.y", "grip_patch.radius"}
    places.add("thermal_foldback.time_constant")
    commanded = {fault.name for fault in OF_A_COMMAND}  # in test_reference_two_way
    assert set(FELT) | places | commanded == set(NEUTRAL)


def test_a_car_without_a_fault_is_the_same_to_the_last_bit_beside_cars_with_faults(sound, faulty):
    for key, value in sound.items():
        assert torch.equal(faulty[key][:, 1::2], value[:, 1::2]), key


def test_neutral_faults_are_the_car_itself_with_nothing_to_carry():
    state, actions = varied(16, 0.3)
    neutral = ReferenceEngine(16, faults=NEUTRAL)
    assert set(neutral.state_spec.keys()) == set(ReferenceEngine().state_spec.keys())
    plain, named = drive(ReferenceEngine(16), state, actions), drive(neutral, state, actions)
    assert (plain == named).all()


def test_every_fault_is_felt(sound, faulty):
    change = (faulty[keys.VELOCITY] - sound[keys.VELOCITY])[:, ::2].abs().amax((0, 2))
    unfelt = [name for name, c in zip(FELT, change, strict=True) if c < 0.01]
    assert unfelt == []


def test_no_fault_makes_a_car_run_away(faulty):
    assert all(value.isfinite().all() for value in faulty.values())
    assert torch.linalg.vector_norm(faulty[keys.VELOCITY][..., :2], dim=-1).max() < 8.0


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] * (i % 4 > 0)) for i, name in enumerate(FELT)],
)
def test_a_batch_of_faults_drives_as_each_car_alone(name, commanded, faulty):
    index = 2 * list(FELT).index(name)
    state, actions = commanded[0][index], commanded[1][:15, index]
    alone = ReferenceEngine(faults={name: FELT[name]} | BESIDE.get(name, {}))
    own = drive(alone, state, actions)
    for key in (keys.POSE, keys.VELOCITY):
        torch.testing.assert_close(own[key], faulty[key][:16, index], atol=2e-4, rtol=1e-4)


def test_the_engine_declares_no_fault_as_a_parameter():
    engine = ReferenceEngine(faults={"tire_grip.grip": 0.7})
    assert not set(NEUTRAL) & set(engine.declared)
    assert engine.declared["grip"].value == ReferenceEngine().declared["grip"].value
    with pytest.raises(KeyError, match="no parameter payload"):
        ReferenceEngine(parameters={"payload.mass_ratio": 1.2})


def test_faults_are_declared_in_full():
    for fault in FAULTS:
        effect, dot, parameter = fault.name.partition(".")
        assert effect
        assert dot
        assert parameter
        assert fault.lower < fault.upper
        assert fault.unit
        assert len(fault.meaning) > 6


def test_faults_are_written_flat_or_nested():
    nested = {"steering_dead_time": {"dead_time": 0.05}, "wind": {"force_x": 0.2, "force_y": 0.1}}
    flat = {"steering_dead_time.dead_time": 0.05, "wind.force_x": 0.2, "wind.force_y": 0.1}
    tensors = {name: torch.tensor([value]) for name, value in flat.items()}
    actions = held(0.0, 0.5, 0.12)
    one = drive(ReferenceEngine(1, faults=nested), start([[1.0, 0, 0]]), actions)
    for engine in (
        ReferenceEngine(1, faults=flat),
        ReferenceEngine(1).with_faults(tensors),
        ReferenceEngine().with_faults(tensors),
        ReferenceEngine().with_faults(TensorDict(tensors, [1])),
        ReferenceEngine().with_faults(TensorDict(tensors, [1]).unflatten_keys(".")),
        make_engine("reference", 1, faults=nested),
    ):
        assert (drive(engine, start([[1.0, 0, 0]]), actions) == one).all()


def test_a_simulator_file_may_hold_a_fault(tmp_path):
    file = tmp_path / "late.yaml"
    file.write_text("engine: reference\noptions: {faults: {payload: {mass_ratio: 1.5}}}\n")
    actions = held(0.0, 0.0, 0.3)
    late = drive(make_engine(file, 1), start(torch.zeros(1, 3)), actions)
    plain = drive(make_engine("reference", 1), start(torch.zeros(1, 3)), actions)
    assert late[keys.VELOCITY][-1, 0, 0] < 0.9 * plain[keys.VELOCITY][-1, 0, 0]


def test_other_parameters_leave_the_faults_as_they_are_and_the_other_way_round():
    mass = TensorDict({"mass": torch.tensor([1.4, 2.0])}, [2])
    grip = {"tire_grip.grip": torch.tensor([0.6, 0.8])}
    late = ReferenceEngine(faults={"steering_dead_time.dead_time": 0.05})
    one = late.with_parameters(mass).with_faults(grip)
    two = late.with_faults(TensorDict(grip, [2])).with_parameters(mass)
    actions = held(0.3, 0.8, 0.4)
    first, second = (drive(e, start(torch.zeros(2, 3)), actions) for e in (one, two))
    assert LINE in first
    assert (first == second).all()
    assert not torch.equal(first[keys.POSE][:, 0], first[keys.POSE][:, 1])


def test_unknown_and_impossible_faults_are_refused_by_name():
    with pytest.raises(KeyError, match=r"no fault wind.force_z; available: .*wind.force_x"):
        ReferenceEngine(faults={"wind": {"force_z": 1.0}})
    with pytest.raises(ValueError, match=r"tire_grip.grip is 7 -: must be in \[0.2, 1.4\]"):
        ReferenceEngine(faults={"tire_grip.grip": 7.0})
    with pytest.raises(ValueError, match=r"payload.mass_ratio is nan"):
        ReferenceEngine().with_faults({"payload.mass_ratio": torch.tensor([1.0, float("nan")])})


def test_a_car_with_every_fault_is_an_honest_engine():
    engine = ReferenceEngine(3, faults=FELT | BESIDE["grip_patch.grip"])
    check_env_specs(engine)
    state = drive(engine, start(torch.tensor([[1.5, 0.0, 0.5]]).expand(3, 3)), held(0, 0.6, 0.2))
    acted = state[-1].clone().set(keys.ACTION, torch.full((3, 2), 0.3))
    one, two = (engine.step(acted.clone())["next"] for _ in range(2))
    assert (one == two).all()


def test_a_car_seen_in_a_turn_goes_on_turning_with_its_faults():
    names = ("steering_dead_time.dead_time", "steering_lag.time_constant")
    faults = {name: FELT[name] for name in (*names, "steering_backlash.width")}
    engine = ReferenceEngine(1, faults=faults)
    steady = drive(engine, start(torch.zeros(1, 3)), held(-0.3, 0.6, 2))[-1]
    again = engine.reset(start(steady[keys.VELOCITY], steady[keys.POSE]), set_state=True)
    torch.testing.assert_close(again[RACK], steady[RACK], atol=0.12, rtol=0)
    assert (again[LINE][..., 1] - 0.6).abs().max() < 0.15
    after = drive(engine, again, held(-0.3, 0.6, 0.05))[-1]
    torch.testing.assert_close(after[keys.VELOCITY], steady[keys.VELOCITY], atol=0.15, rtol=0.06)


def test_what_a_fault_carries_starts_anew_with_the_car():
    engine = ReferenceEngine(1, faults={"heating_motor.rise": 0.01})
    hot = drive(engine, start(torch.zeros(1, 3)), held(0.5, 0, 1))[-1]
    again = engine.reset(hot.select(keys.POSE, keys.VELOCITY).clone(), set_state=True)
    assert hot[HEAT] > 1.0  # [J]
    assert again[HEAT] == 0
    assert again[CHARGE] < hot[CHARGE]


def test_only_what_a_car_needs_is_computed():
    like = torch.zeros(3)
    neutral = Faults({"wind.force_x": torch.zeros(3)}, like)
    windy = Faults({"wind.force_x": torch.tensor([0.0, 0.2, 0.0])}, like)
    assert "wind" not in neutral
    assert "wind" in windy
    assert list(windy) == ["wind"]
