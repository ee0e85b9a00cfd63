"""What every plant must prove, whatever moves the car in it."""

import ast
import builtins
import copy
import pickle
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import check_env_specs

import buggy_rl.proof.plants
from buggy_rl.core import keys
from buggy_rl.policies.controllers.recording import recorded_steps
from buggy_rl.policies.controllers.room import RoomDriver
from buggy_rl.proof.plants import PLANTS, abilities, make_plant
from buggy_rl.proof.plants.commonroad_car import library
from buggy_rl.proof.plants.faults import FAULTS
from buggy_rl.simulators.mujoco import MujocoEngine
from buggy_rl.simulators.reference import ReferenceEngine
from tests.proof.plants.drives import EVERY, FOREIGN, drive, faulty, sound, start, warmed

SEVERAL = {
    "steering_dead_time": {"dead_time": 0.033},
    "throttle_lag": {"time_constant": 0.1},
    "steering_backlash": {"width": 0.2},
    "battery_sag": {"loss_per_minute": 0.3},
    "wind": {"force_x": 0.3, "force_y": -0.2},
    "grip_patch": {"x": 0.3, "y": 0.1, "radius": 1.0, "grip": 0.4},
    "payload": {"mass_ratio": 1.3},
}
WILD = ((15, 0.6, 0.8), (15, -1.0, -0.6), (15, 1.0, 0.1))
THERE = {"pose": (0.5, -1.0, 0.8), "velocity": (1.2, 0.1, 0.6)}


def wild(seed, steps, cars):
    """Actions [steps, cars, 2] from everywhere."""
    generator = torch.Generator().manual_seed(seed)
    return 2 * torch.rand(steps, cars, 2, generator=generator) - 1


@torch.no_grad()
def states(engine, actions):
    """All that is in the TensorDict after each of the actions [T, *, 2], from a start in motion."""
    given = {
        keys.POSE: torch.tensor([0.4, -0.2, 0.7]).expand(*engine.batch_size, 3),
        keys.VELOCITY: torch.tensor([1.5, 0.05, 0.4]).expand(*engine.batch_size, 3),
    }
    state = engine.reset(TensorDict(given, engine.batch_size), set_state=True)
    for action in actions:
        state = engine.step(state.clone().set(keys.ACTION, action))["next"]
        yield state


@pytest.mark.parametrize("plant", EVERY)
@pytest.mark.parametrize("faults", [{}, SEVERAL], ids=["sound", "faulty"])
def test_a_plant_keeps_the_contract_of_an_environment(plant, faults):
    plant = make_plant(plant, 2, faults)
    assert plant.batch_size == (2,)
    assert plant.action_spec.shape == (2, 2)
    check_env_specs(plant)


@pytest.mark.parametrize("plant", EVERY)
def test_two_steps_from_one_state_are_equal_and_cars_are_alike(plant):
    car = make_plant(plant, 2, SEVERAL)
    *_, state = states(car, wild(0, 12, 1).expand(12, 2, 2))
    state = state.set(keys.ACTION, torch.tensor([[0.7, -0.4], [0.7, -0.4]]))
    first, second = (car.step(state.clone())["next"] for _ in range(2))
    for key in car.observation_spec.keys():  # noqa: SIM118
        assert torch.equal(first[key], second[key]), key
        assert torch.equal(first[key][0], first[key][1]), key


@pytest.mark.parametrize("plant", EVERY)
def test_a_reset_starts_where_it_is_told_and_an_edit_is_honoured(plant):
    car = sound(plant)
    state = start(car, **THERE)
    assert torch.equal(state[keys.POSE], torch.tensor([THERE["pose"]]))
    assert torch.equal(state[keys.VELOCITY], torch.tensor([THERE["velocity"]]))
    action = torch.tensor([[0.0, 0.2]])
    state = car.step(state.set(keys.ACTION, action))["next"]
    edited = state.clone().set(keys.ACTION, action)
    edited[keys.POSE] = edited[keys.POSE] + torch.tensor([[2.0, -3.0, 0.0]])
    edited[keys.VELOCITY] = edited[keys.VELOCITY] + torch.tensor([[0.8, 0.0, 0.0]])
    told, untold = car.step(edited)["next"], car.step(state.set(keys.ACTION, action))["next"]
    assert told[keys.VELOCITY][0, 0] - untold[keys.VELOCITY][0, 0] == pytest.approx(0.8, abs=0.05)
    moved = told[keys.POSE] - edited[keys.POSE]
    # One step of 10 ms at 1.99 m/s, heading 0.8 rad.
    assert moved[0, :2].norm() == pytest.approx(0.02, abs=0.0006)


@pytest.mark.parametrize("plant", FOREIGN)
def test_turning_the_world_changes_nothing_but_the_pose(plant):
    here = drive(sound(plant), *WILD, velocity=(1.0, 0.0, 0.0))
    there = drive(sound(plant), *WILD, velocity=(1.0, 0.0, 0.0), pose=(0.0, 0.0, 2.0))
    assert torch.allclose(here, there, atol=2e-3)


def test_without_faults_the_mujoco_plant_is_the_mujoco_engine_to_the_last_bit():
    actions = wild(1, 60, 3)
    own = {"mass": 1.7, "steering_lag": 0.05}
    for parameters in (None, own):
        engine = MujocoEngine(3, parameters=parameters)
        plant = make_plant("mujoco", 3, {}, parameters)
        for ours, theirs in zip(states(plant, actions), states(engine, actions), strict=True):
            for key in theirs.keys():  # noqa: SIM118
                assert torch.equal(ours[key], theirs[key]), key


def test_the_reference_plant_is_the_reference_engine():
    faults = {"tire_grip": {"grip": 0.7}}
    actions = wild(2, 20, 2)
    plant, engine = make_plant("reference", 2, faults), ReferenceEngine(2, faults=faults)
    for ours, theirs in zip(states(plant, actions), states(engine, actions), strict=True):
        assert torch.equal(ours[keys.VELOCITY], theirs[keys.VELOCITY])


@pytest.mark.parametrize("plant", FOREIGN)
def test_neutral_faults_change_nothing(plant):
    neutral = {}
    for name, fault in FAULTS.items():
        effect, _, parameter = name.partition(".")
        if effect in abilities(plant):  # a time constant alone is no fault
            neutral.setdefault(effect, {})[parameter] = fault.value
    assert set(neutral) == abilities(plant)
    assert torch.equal(
        drive(make_plant(plant, 1, neutral), *WILD), drive(make_plant(plant, 1, {}), *WILD)
    )


@pytest.mark.slow
def test_each_effect_of_a_plant_changes_its_drive():
    felt = {"grip_patch": {"radius": 10.0, "grip": 0.5}, "motor_power_limit": {"power_per_mass": 2}}
    felt["thermal_foldback"] = {"foldback": 0.9, "time_constant": 1.0}
    usual = drive(sound("mujoco"), *WILD)
    for effect in sorted(abilities("mujoco")):
        parameters = felt.get(effect) or {
            name.partition(".")[2]: fault.lower if fault.value == fault.upper else fault.upper
            for name, fault in FAULTS.items()
            if name.startswith(f"{effect}.")
        }
        changed = drive(faulty("mujoco", effect, **parameters), *WILD)
        size = (changed - usual).abs().max()
        assert size > 0.005, effect


def test_the_foreign_plants_have_enough_abilities():
    assert len(abilities("mujoco")) >= 33
    assert len(abilities("commonroad")) >= 32
    assert abilities("reference") > abilities("mujoco")
    assert {"sticky_servo", "wheel_wobble"} <= abilities("reference")


@pytest.mark.parametrize("plant", FOREIGN)
def test_what_a_plant_does_not_have_is_refused_with_what_there_is(plant):
    with pytest.raises(KeyError, match=r"no effect gyro_bias; available: .*wind"):
        make_plant(plant, 1, {"gyro_bias": {"bias": 0.1}})
    with pytest.raises(KeyError, match="no parameter angle; it has dead_time"):
        make_plant(plant, 1, {"steering_dead_time": {"angle": 0.1}})
    with pytest.raises(ValueError, match=r"tire_grip.grip is 3 -: must be in \[0.2, 1.5\]"):
        make_plant(plant, 1, {"tire_grip": {"grip": 3.0}})
    with pytest.raises(KeyError, match="no parameter colour"):
        make_plant(plant, 1, {}, {"colour": 1.0})


def test_an_unknown_plant_is_refused_with_the_known_ones():
    with pytest.raises(ValueError, match="no plant 'bicycle'; available: reference, mujoco"):
        make_plant("bicycle", 1, {})
    assert PLANTS == ("reference", "mujoco", "commonroad", "rally")


def test_a_missing_library_is_named_with_what_installs_it(monkeypatch):
    real = builtins.__import__

    def without(name, *args, **kwargs):
        if name.startswith("vehiclemodels"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return real(name, *args, **kwargs)

    library.cache_clear()
    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ModuleNotFoundError, match="pip install 'commonroad-vehicle-models"):
        make_plant("commonroad", 1, {})


def test_no_plant_imports_the_effect_library():
    folder = Path(buggy_rl.proof.plants.__file__).parent
    files = sorted(folder.rglob("*.py"))
    assert len(files) >= 8
    for file in files:
        for node in ast.walk(ast.parse(file.read_text())):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{file.name}: relative import"
                names = [f"{node.module}.{alias.name}" for alias in node.names]
            assert not [n for n in names if n.startswith("buggy_rl.effects")], file.name
            assert not [n for n in names if n.startswith("buggy_rl.task.env")], file.name


@pytest.mark.parametrize("plant", FOREIGN)
def test_parameters_can_differ_from_car_to_car_and_faults_stay(plant):
    car = make_plant(plant, 1, {"rolling_resistance": {"deceleration": 0.5}})
    pair = car.with_parameters(TensorDict({"mass": torch.tensor([1.625, 2.2])}, [2]))
    alone = copy.copy(drive(car, *WILD))
    actions = torch.cat([torch.tensor([[t, s]]).expand(n, 2) for n, t, s in WILD])
    state = pair.reset()
    with torch.no_grad():
        for action in actions:
            state = pair.step(state.set(keys.ACTION, action.expand(2, 2)))["next"]
    assert torch.allclose(state[keys.VELOCITY][0].double(), alone[-1], atol=1e-6)
    assert state[keys.VELOCITY][1, 0] < state[keys.VELOCITY][0, 0] - 0.05


@pytest.mark.parametrize("plant", FOREIGN)
def test_a_parked_car_stays_parked(plant):
    velocity = drive(sound(plant), (50, -1.0, 0.7))
    assert velocity.abs().max() < 1e-3


def test_a_spinning_commonroad_car_loses_energy_until_it_rolls():
    pytest.importorskip("vehiclemodels")
    velocity = drive(sound("commonroad"), (100, -1.0, 0.0), velocity=(-0.3, 2.5, 8.0))
    energy = velocity[:, :2].square().sum(1) + 0.0049 / 1.625 * velocity[:, 2].square()
    assert (energy.diff() < 0.02).all()
    # A friction of 0.85 g ends 2.5 m/s in 0.3 s; what is left rolls straight on.
    assert velocity[60:, :2].norm(dim=1).max() < 1.2
    assert velocity[60:, 1:].abs().max() < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("plant", FOREIGN)
def test_the_room_driver_keeps_a_plant_inside_and_on_course(plant):
    rows = list(recorded_steps(make_plant(plant, 2, {}), RoomDriver(seed=5), 400))
    rows = TensorDict.stack(rows, 1)
    vx, vy, _ = rows[keys.VELOCITY].unbind(-1)
    drifting = (torch.atan2(vy, vx.clamp_min(0.3)).abs() > 0.35).float().mean()
    assert rows[keys.POSE][..., :2].abs().max() < 4.0
    assert drifting < 0.1
    assert vx.max() > 1.5


def test_a_warmed_state_fits_a_faulty_car():
    state = warmed("mujoco", (5, 0.2, 0.3))
    assert set(state.keys()) >= set(faulty("mujoco", "wind", force_x=0.2).observation_spec.keys())


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda car: pickle.loads(pickle.dumps(car))])
def test_a_copy_of_a_mujoco_plant_stands_on_the_same_slope(copied):
    plant = faulty("mujoco", "floor_slope", along_x=0.4, along_y=0.1)
    one, other = (drive(car, *WILD, **THERE) for car in (plant, copied(plant)))
    assert torch.equal(one, other)
    assert not torch.equal(one, drive(sound("mujoco"), *WILD, **THERE))
