"""The reference car at any size: similar cars drive similar paths."""

from dataclasses import asdict

import pytest
import torch
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.core.car_file import load_car
from buggy_rl.core.vehicle import Similarity, VehicleDimensions, similar_dimensions
from buggy_rl.simulators import make_engine
from buggy_rl.simulators.reference import ReferenceEngine
from buggy_rl.simulators.reference.car import BRAKED_KERNEL
from buggy_rl.simulators.reference.faults import FAULTS

LENGTH = 4.0  # twice the speeds, over twice the time
BUGGY = VehicleDimensions()
LARGE = {"wheelbase": LENGTH * BUGGY.wheelbase, "mass": LENGTH**3 * BUGGY.mass}
SCALE = Similarity.between(similar_dimensions(LARGE))
SPEED = {"kind": "speed", "reverse": True}
UNITS = {fault.name: fault.unit for fault in FAULTS}
FAULTY = {  # those with constants of the car's parts in them
    "payload.mass_ratio": 1.3,
    "battery_sag.loss_per_minute": 0.5,
    "one_sided_drag.yaw_acceleration": 8.0,
    "motor_power_limit.power_per_mass": 3.0,
    "wind.force_x": 0.3,
    "grip_patch.x": 0.3,
    "grip_patch.radius": 0.5,
    "grip_patch.grip": 0.4,
    "yaw_damping.rate": 4.0,
    "aerodynamic_drag.coefficient": 0.1,
}


def reference(**options) -> ReferenceEngine:
    engine = make_engine("reference", 1, **options)
    assert isinstance(engine, ReferenceEngine)
    return engine


def rows(engine, seconds=0.8):
    """Motion [T, 1, 6] under fixed commands, each held for 0.2 s of a buggy's time."""
    generator, state, shown = torch.Generator().manual_seed(3), engine.reset(), []
    with torch.no_grad():
        for row in range(round(seconds * 100)):
            if row % 20 == 0:
                action = 2 * torch.rand(1, 2, generator=generator) - 1
                action[:, 0] = 0.9 if row < 40 else action[:, 0]
            state[keys.ACTION] = action.clone()
            state = engine.step(state)["next"].exclude(keys.REWARD)
            shown.append(torch.cat([state[keys.POSE], state[keys.VELOCITY]], -1))
    return torch.stack(shown)


@pytest.mark.parametrize(
    ("command", "faults"),
    [
        ("throttle", FAULTY),
        ("throttle_brake_reverse", {}),
        pytest.param("throttle_brake_reverse", FAULTY, marks=pytest.mark.slow),
        pytest.param(SPEED, {}, marks=pytest.mark.slow),
        pytest.param("current", {}, marks=pytest.mark.slow),
    ],
)
def test_a_similar_car_drives_the_similar_path_over_the_similar_time(command, faults):
    scaled = {name: SCALE.of(UNITS[name]) * value for name, value in faults.items()}
    if scaled:
        scaled["battery_sag.loss_per_minute"] /= SCALE.time  # of a drive as much longer
    own = {"command": command, "faults": faults, "substep": 0.002}
    of_buggy = rows(reference(**own))
    of_large = rows(
        reference(
            dimensions=LARGE,
            dt=0.01 * SCALE.time,
            **own | {"faults": scaled, "substep": 0.002 * SCALE.time},
        )
    )
    factors = torch.tensor([SCALE.of(u) for u in ("m", "m", "rad", "m/s", "m/s", "rad/s")])
    assert of_buggy[..., 3].abs().max() > 0.3  # it drives
    torch.testing.assert_close(of_large / factors, of_buggy, rtol=1e-4, atol=1e-4)


def test_a_car_of_another_shape_drives_another_path():
    high = LARGE | {"cg_height": 2 * LENGTH * BUGGY.cg_height}
    options = {"dt": 0.01 * SCALE.time, "substep": 0.002 * SCALE.time}
    one, other = (rows(reference(dimensions=d, **options)) for d in (LARGE, high))
    assert (one - other)[..., :2].abs().max() > 0.02 * LENGTH


@pytest.mark.parametrize("car", ["autorally", "full_size"])
def test_a_car_s_file_makes_it_that_car(car):
    file, engine = load_car(car), reference(car=car)
    assert engine.similarity == file.similarity
    values = {name: p.value for name, p in engine.declared.items()}
    assert values["lock_left"] == pytest.approx(file.steering.left)
    for name in ("mass", "yaw_inertia", "cg_height", "cg_to_front_axle"):
        assert values[name] == pytest.approx(getattr(file.vehicle, name))
    again = engine.with_parameters(TensorDict({"grip": torch.tensor([0.5, 0.6, 0.7])}, [3]))
    assert asdict(again.vehicle()) == pytest.approx(asdict(file.vehicle), rel=1e-5)
    assert again.with_faults({"payload.mass_ratio": torch.ones(3)}).build == engine.build


def test_the_buggy_s_file_is_the_car_without_one():
    plain, named = reference(), reference(car="buggy")
    assert named.declared == plain.declared
    assert named.build.usual
    assert not reference(car="autorally").build.usual


def test_a_car_with_other_driven_wheels_is_refused():
    with pytest.raises(ValueError, match=r"has rear-wheel drive, car f1tenth drives all: mujoco"):
        reference(car="f1tenth")


def test_ranges_of_faults_grow_with_the_car():
    far = {"grip_patch.x": 60.0}
    with pytest.raises(ValueError, match=r"grip_patch.x is 60 m: must be in \[-20, 20\]"):
        reference(faults=far)
    engine = reference(faults=far, dimensions=LARGE)
    with pytest.raises(ValueError, match=r"must be in \[-80, 80\]"):
        engine.with_faults({"grip_patch.x": torch.tensor([90.0])})


@pytest.mark.parametrize("size", [{}, LARGE], ids=["buggy", "large"])
def test_the_braked_car_s_kernel_is_its_substep(packaged, size):
    options = {"command": "throttle_brake_reverse", "dimensions": size or None}
    by_pytorch = rows(reference(**options), 0.5)
    assert reference(**options).car.kernel is BRAKED_KERNEL  # type: ignore[attr-defined]
    assert reference(**options, faults={"payload.mass_ratio": 1.2}).car.kernel is None
    packaged()
    torch.testing.assert_close(rows(reference(**options), 0.5), by_pytorch, rtol=1e-4, atol=1e-4)
