"""The standard car behaves like a car."""

import numpy as np
import pytest

from buggy_rl.proof.plants.rally.car import RallyCar
from buggy_rl.proof.plants.rally.changes import CHANGES
from buggy_rl.proof.plants.rally.unknowns import UNKNOWNS
from tests.proof.plants.rally.drives import OFF, drive, parameters, same, weave

# Pose, velocity, and both as they are shown, of two cars after 0.6 s of weaving, with every change
# in the middle of its range and every unknown effect at its geometric mean: the numbers of the code
# as its author handed it over.
HANDED_OVER = [
    [
        *(1.3257678181816366, 0.14403876211745031, 0.3082287378790622),
        *(1.961360097282993, 0.08973399094994737, 0.719060438382342),
        *(1.3275733967462169, 0.14186195264348095, 0.27094405835536767),
        *(1.9621066030904768, 0.09584826024588075, 0.7334855963852425),
    ],
    [
        *(1.359992788919238, 0.11223289934000488, 0.23186047859058062),
        *(2.0659114198677044, 0.04883172170498916, 0.5190024483939207),
        *(1.3636039233602733, 0.10889453615984791, 0.2747345692884937),
        *(2.068772205963603, 0.0527393860253104, 0.5702115661578021),
    ],
]


def test_equations_and_numbers_are_those_that_were_handed_over() -> None:
    """All changes and unknown effects at once end where the author's own code ended."""
    changes = {
        name: {key: 0.5 * (low + high) for key, (low, high) in row.items()}
        for name, row in CHANGES.items()
    }
    unknown = {name: (row[0] * row[1]) ** 0.5 for name, row in UNKNOWNS.items()}
    result = drive(RallyCar(parameters(2), changes, unknown), weave(60))
    ends = [result[key][-1] for key in ("pose", "velocity", "shown_pose", "shown_velocity")]
    np.testing.assert_allclose(np.concatenate(ends, 1), HANDED_OVER, rtol=1e-6)


def test_energy_falls_without_drive() -> None:
    """Rolling, sliding sideways and spinning cars only lose energy."""
    cars = 12
    car = RallyCar(parameters(cars))
    rng = np.random.default_rng(2)
    velocity = rng.uniform([-1, -3, -8], [6, 3, 8], (cars, 3))
    state = car.start(np.zeros((cars, 3)), velocity)
    energy = [car.energy(state)]
    for index in range(200):
        state = car.step(state, [-1.0, np.sin(0.1 * index)])
        energy.append(car.energy(state))
    energy = np.array(energy)
    assert (np.diff(energy, axis=0) < 2e-3 * energy[0]).all()
    # Over 0.1 s no growth at all beyond rounding of the suspension's small oscillations.
    assert (energy[10:] < energy[:-10] + 2e-4 * energy[0]).all()
    assert (energy[-1] < 0.8 * energy[0]).all()


def test_standing_car_stays() -> None:
    """No command, no speed: nothing moves."""
    result = drive(RallyCar(parameters(4)), np.tile(OFF, (100, 1)), speed=0.0)
    assert np.abs(result["pose"]).max() < 1e-9
    assert np.abs(result["velocity"]).max() < 1e-9


def test_slow_turn_is_kinematic() -> None:
    """At low speed the rear axle turns with wheelbase over tangent of the steer angle."""
    car = RallyCar(parameters(8))
    k = car.constants
    result = drive(car, np.tile([-0.75, 0.5], (150, 1)), speed=0.5)
    last = result["last"]
    radius = last["vx"] / last["yaw_rate"]
    ratio = radius * np.tan(last["rack"]) / k["wheelbase"]
    assert (np.abs(ratio - 1.0) < 0.06).all()


def test_lateral_acceleration_saturates() -> None:
    """Slowly growing lock at speed: the greatest lateral acceleration is near grip times g."""
    car = RallyCar(parameters(8), changes={"grip_all": {"ratio": 0.7}})
    ramp = np.stack([np.full(150, 0.2), np.linspace(0.0, 1.0, 150)], axis=1)
    velocity = drive(car, ramp, speed=3.0)["velocity"]
    speed = np.sqrt(velocity[..., 0] ** 2 + velocity[..., 1] ** 2)
    use = (speed * velocity[..., 2]).max(axis=0) / (9.81 * car.constants["grip"][:, 0])
    assert (use > 0.7).all()
    assert (use < 1.1).all()
    assert np.median(use) > 0.75


@pytest.mark.slow
def test_reaches_top_speed() -> None:
    """Full drive straight on ends near the drawn top speed."""
    car = RallyCar(parameters(8))
    result = drive(car, np.tile([1.0, 0.0], (800, 1)), speed=1.0)
    ratio = result["velocity"][-1, :, 0] / car.constants["top_speed"]
    assert (np.abs(ratio - 1.0) < 0.12).all()
    assert np.abs(result["pose"][..., 1]).max() < 1e-6


def test_mirror() -> None:
    """Mirrored steering gives the mirrored drive."""
    car, commands = RallyCar(parameters(6)), weave(100, steer=0.9)
    left, right = drive(car, commands), drive(car, commands * [1.0, -1.0])
    assert np.abs(left["pose"] - right["pose"] * [1, -1, -1]).max() < 1e-9


@pytest.mark.slow
def test_step_halving() -> None:
    """Half the integration step changes 1 s drives by less than 1 % of the way."""
    drawn, commands = parameters(8), weave(100)
    coarse, fine = drive(RallyCar(drawn), commands), drive(RallyCar(drawn, substeps=20), commands)
    gap = np.linalg.norm((coarse["pose"] - fine["pose"])[..., :2], axis=-1).max(axis=0)
    way = np.linalg.norm(np.diff(fine["pose"][..., :2], axis=0), axis=-1).sum(axis=0)
    assert (gap < 0.01 * way).all()


@pytest.mark.slow
def test_random_commands_stay_bounded() -> None:
    """5 s of random commands: finite, within the speed and attitude of such a car."""
    car = RallyCar(parameters(20))
    commands = np.repeat(np.random.default_rng(3).uniform(-1, 1, (25, 2)), 20, axis=0)
    result = drive(car, commands, speed=1.0)
    last, velocity = result["last"], result["velocity"]
    assert all(np.isfinite(value).all() for value in last.values())
    assert np.abs(velocity[..., :2]).max() < 9.0
    assert np.abs(velocity[..., 2]).max() < 20.0
    assert np.abs(last["roll"]).max() < 0.2
    assert np.abs(last["pitch"]).max() < 0.2


@pytest.mark.slow
def test_spinning_and_stopped_car_come_to_rest() -> None:
    """Dropped while spinning at 10 rad/s: at rest within 4 s, then it stays."""
    car = RallyCar(same(2))
    state = car.start(np.zeros(3), np.array([0.5, -1.0, 10.0]))
    for _ in range(600):
        state = car.step(state, OFF)
    assert np.abs(car.velocity(state)).max() < 0.05


@pytest.mark.slow
def test_rows_are_independent_and_step_is_pure() -> None:
    """A row has the same bits alone and in a batch of eight; the state is not changed."""
    drawn = parameters(8)
    changes = {name: {key: pair[1] for key, pair in row.items()} for name, row in CHANGES.items()}
    unknown = {name: row[1] for name, row in UNKNOWNS.items()}
    car = RallyCar(drawn, changes, unknown)
    batch = drive(car, weave(60))
    for row in (0, 5):
        alone = RallyCar(
            {key: value[row : row + 1] for key, value in drawn.items()}, changes, unknown
        )
        single = drive(alone, weave(60))
        for key in ("pose", "velocity", "shown_pose", "shown_velocity"):
            assert np.array_equal(single[key][:, 0], batch[key][:, row]), key
    state = batch["last"]
    copies = {key: value.copy() for key, value in state.items()}
    first, second = car.step(state, [0.5, 0.5]), car.step(state, [0.5, 0.5])
    assert all(np.array_equal(copies[key], state[key]) for key in state)
    assert all(np.array_equal(first[key], second[key]) for key in first)
    assert all(len(value) == 8 for value in first.values())
