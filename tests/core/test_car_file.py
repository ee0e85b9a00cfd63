"""Cars by name and by file: presets are sourced, engines become them, faults are named."""

import re

import pytest
import torch
from tensordict import TensorDict

from buggy_rl.core.car_file import PRESETS, load_car
from buggy_rl.core.config import ConfigError
from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.recordings.recording import Limits
from buggy_rl.simulators import make_engine

pytestmark = pytest.mark.usefixtures("without_gradients")

NAMES = sorted(file.stem for file in PRESETS.glob("*.yaml"))
SMALL = "dimensions: {mass: 0.1, wheelbase: 0.098}\n"


def write(folder, text, name="mine.yaml"):
    (folder / name).write_text(text)
    return str(folder / name)


def test_the_cars_of_the_field_are_there():
    needed = {"buggy", "dart", "f1tenth", "mushr", "autorally", "full_size"}
    assert needed <= set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_every_number_of_a_preset_has_a_source_or_is_said_to_be_assumed(name):
    text = (PRESETS / f"{name}.yaml").read_text()
    listed = set(re.findall(r"^# .*?(\[[a-z]\])", text, re.M)) | set(
        re.findall(r"(\[[a-z]\]) ", text)
    )
    for line in text.splitlines():
        if re.match(r"\s*\w+: +-?[\d.]+ ", line):
            comment = line.partition("#")[2]
            cited = set(re.findall(r"\[[a-z]\]", comment))
            assert cited or "assumed" in comment, f"{name}: {line}"
            assert cited <= listed, f"{name}: {line}"


@pytest.mark.parametrize("name", NAMES)
def test_a_preset_is_a_car_that_engines_can_be(name):
    car = load_car(name)
    engine = make_engine("single_track", 2, car=name)
    assert engine.vehicle().mass == pytest.approx(car.vehicle.mass)
    assert engine.vehicle().wheelbase == pytest.approx(car.vehicle.wheelbase, rel=1e-5)
    state = engine.reset()
    for _ in range(300):
        state["action"] = torch.tensor([[1.0, 0.3], [1.0, -0.3]])
        state = engine.step(state)["next"].exclude("reward")
    assert state["velocity"][:, 0].min() > 0.3
    assert state["velocity"][:, 0].max() < 1.5 * car.top_speed
    assert state["velocity"][0, 2] > 0 > state["velocity"][1, 2]


def test_the_buggys_file_is_the_buggy_of_the_code():
    car = load_car("buggy")
    assert car.vehicle == VehicleDimensions()
    assert Limits().for_car(car) == Limits()
    for engine in ("single_track", "mujoco"):
        assert make_engine(engine, car="buggy").declared == make_engine(engine).declared


def test_full_lock_turns_the_wheels_by_the_stated_angle():
    from buggy_rl.simulators.bicycle.actuation import road_wheel_angle

    engine = make_engine("single_track", car="dart")
    left = road_wheel_angle(torch.tensor(1.0), engine.values)
    right = road_wheel_angle(torch.tensor(-1.0), engine.values)
    assert left.item() == pytest.approx(0.320, abs=1e-4)
    assert right.item() == pytest.approx(-0.403, abs=1e-4)


@pytest.mark.parametrize("name", ["buggy", "autorally", "full_size"])
def test_mujoco_stands_still_and_drives_as_the_car(name):
    car = load_car(name)
    engine = make_engine("mujoco", (2,), car=name)
    assert engine.vehicle().mass == pytest.approx(car.vehicle.mass)
    state = engine.reset()
    for command in ([-1.0, 0.0], [0.5, 0.2]):
        for _ in range(100):
            state["action"] = torch.tensor([command] * 2)
            state = engine.step(state)["next"].exclude("reward")
        if command[0] < 0:
            assert state["velocity"].abs().max() < 1e-3 * car.similarity.speed
    assert 0.3 * car.similarity.speed < state["velocity"][0, 0] < car.top_speed
    assert state["velocity"][0, 2] > 0.1 * car.similarity.of("rad/s")


def test_an_all_wheel_driven_car_with_a_speed_command_is_one_in_mujoco_too():
    engine = make_engine("mujoco", 2, car="f1tenth")
    assert engine.command.kind == "speed"
    assert engine.declared["full_speed"].value == 20.0
    assert engine.with_parameters(TensorDict({}, [3])).car.drive == "all"


@pytest.mark.parametrize("engine", ["buggy_rl.simulators.base:HoldEngine"])
def test_a_simulator_that_has_no_dimensions_is_refused_a_car(engine):
    with pytest.raises(ValueError, match="cannot be the car 'dart'"):
        make_engine(engine, car="dart")


def test_holding_the_velocity_knows_no_car():
    assert make_engine("hold", 3, car="full_size").batch_size == (3,)


def test_one_s_own_car_needs_no_more_than_mass_and_wheelbase(tmp_path):
    car = load_car(write(tmp_path, SMALL))
    assert car.name == "mine"
    assert "yaw_inertia" in car.assumed
    limits = Limits().for_car(car)
    assert limits.top_speed == pytest.approx(1.5 * 10 * (0.098 / 0.174) ** 0.5)
    assert limits.leap_yaw > Limits().leap_yaw  # small cars yaw faster
    assert Limits(top_speed=4.0).for_car(car).top_speed == 4.0  # a stated limit stays


def test_a_simulator_file_names_a_car_beside_it(tmp_path):
    write(tmp_path, SMALL)
    file = write(tmp_path, "engine: single_track\noptions: {car: mine.yaml}\n", "sim.yaml")
    assert make_engine(file).vehicle().mass == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("dimensions: {mass: 1.0}", r"needed but not given: \['wheelbase'\]"),
        ("dimensions: {mass: -1.0, wheelbase: 0.2}", "mass is -1.0: must be above 0"),
        ("dimensions: {mass: 1.0, wheelbase: 0.2}\ndriven: all", "unknown key 'driven'"),
        (SMALL + "command: {kind: speed}", "needs command.full_speed"),
        (SMALL + "drive: both", "drive"),
        ("- 1", "expected keys and values"),
        ("dimensions: {", "is not YAML"),
    ],
)
def test_a_wrong_file_is_refused_in_one_line_that_names_it(tmp_path, text, words):
    with pytest.raises(ConfigError, match=words) as caught:
        load_car(write(tmp_path, text))
    assert "mine" in str(caught.value)


def test_an_unknown_car_is_refused_with_those_that_are_there():
    with pytest.raises(ConfigError, match="no car 'tesla'; available: autorally, buggy"):
        load_car("tesla")
