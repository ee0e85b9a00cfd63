"""Changes act in the expected direction; unknown effects move the car, and not at size zero."""

from functools import lru_cache

import numpy as np
import pytest

from buggy_rl.proof.plants.rally.car import RallyCar
from buggy_rl.proof.plants.rally.changes import CHANGES, NEUTRAL
from buggy_rl.proof.plants.rally.unknown_sensor import SENSOR
from buggy_rl.proof.plants.rally.unknowns import UNKNOWNS
from tests.proof.plants.rally.drives import OFF, drive, moved, parameters, weave

DRAWN = parameters(8)


SENSORS = {kind.name for kind in SENSOR}
MOVING = [n for n in UNKNOWNS if n not in SENSORS | {"board_bounce"}]  # its floor does work


@lru_cache(maxsize=1)
def plain_drive() -> dict[str, np.ndarray]:
    """The standard weave of the drawn cars without changes."""
    return drive(RallyCar(DRAWN), weave(100))


def run(commands: np.ndarray, speed: float = 2.5, **changes: dict) -> dict[str, np.ndarray]:
    """Drive with changes given as name={argument: value}."""
    return drive(RallyCar(DRAWN, changes), commands, speed)


COAST = np.tile(OFF, (60, 1))
PULL = np.tile([1.0, 0.0], (60, 1))
TURN = np.tile([0.0, 0.6], (60, 1))
LOCK = np.tile([0.0, 1.0], (60, 1))


def speed_end(result: dict[str, np.ndarray]) -> np.ndarray:
    """Forward speed at the end."""
    return result["velocity"][-1, :, 0]


def turned(result: dict[str, np.ndarray]) -> np.ndarray:
    """Heading at the end."""
    return result["pose"][-1, :, 2]


def side(result: dict[str, np.ndarray]) -> np.ndarray:
    """Sideways place at the end."""
    return result["pose"][-1, :, 1]


LESS, MORE = -1.0, 1.0
CASES = [
    ("grip_all", {"ratio": 0.5}, LOCK, turned, LESS),
    ("grip_balance", {"ratio": 0.7}, LOCK, turned, LESS),
    ("grip_patch", {"x": 0.7, "radius": 1.0, "ratio": 0.3}, LOCK, turned, LESS),
    ("payload", {"mass": 1.0}, PULL, speed_end, LESS),
    ("rolling_resistance", {"coefficient": 0.05}, COAST, speed_end, LESS),
    ("air_drag", {"area": 0.1}, COAST, speed_end, LESS),
    ("wind", {"y": 4.0}, COAST, side, MORE),
    ("wind", {"x": 4.0}, COAST, speed_end, MORE),
    ("slope", {"x": 0.05}, COAST, speed_end, LESS),
    ("slope", {"y": 0.05}, COAST, side, LESS),
    ("drive_loss", {"ratio": 0.5}, PULL, speed_end, LESS),
    ("throttle_dead_time", {"seconds": 0.1}, PULL, speed_end, LESS),
    ("steering_dead_time", {"seconds": 0.1}, TURN, turned, LESS),
    ("steering_gain", {"ratio": 0.6}, TURN, turned, LESS),
    ("steering_offset", {"angle": 0.05}, COAST, turned, MORE),
    ("steering_slack", {"angle": 0.1}, TURN, turned, LESS),
    ("steering_rate", {"limit": 0.6}, TURN, turned, LESS),
    ("dragging_wheel", {"torque": 0.05}, COAST, turned, MORE),
    ("dragging_wheel", {"torque": -0.05}, COAST, turned, LESS),
    ("tyre_stiffness", {"ratio": 0.5}, TURN, turned, LESS),
]


@pytest.mark.parametrize(("name", "given", "commands", "measure", "sign"), CASES)
def test_change_direction(name: str, given: dict, commands: np.ndarray, measure, sign) -> None:
    """The change moves its measure the expected way in (nearly) every drawn car."""
    twice = {key: np.concatenate([value] * 2) for key, value in DRAWN.items()}
    mixed = {
        key: np.repeat([NEUTRAL[name][key], given.get(key, NEUTRAL[name][key])], 8)
        for key in NEUTRAL[name]
    }
    value = measure(drive(RallyCar(twice, {name: mixed}), commands, 2.5))
    gap = value[8:] - value[:8]
    assert (sign * gap > 0.0).mean() >= 0.8
    assert sign * np.median(gap) > 1e-3


def test_softer_suspension_leans_more() -> None:
    """Half the spring rate, more roll in a bend."""
    soft = run(TURN, suspension_stiffness={"ratio": 0.5})["last"]["roll"]
    assert (soft > run(TURN)["last"]["roll"]).all()


def test_neutral_changes_do_nothing() -> None:
    """All changes at their neutral values give the same bits."""
    assert set(CHANGES) == set(NEUTRAL)
    commands = weave(60)
    assert np.array_equal(run(commands, **NEUTRAL)["pose"], run(commands)["pose"])


@pytest.mark.slow
def test_sizes_of_changes() -> None:
    """An end of the range of every change moves a 1 s weave by more than 3 mm."""
    commands, plain = weave(100), plain_drive()
    for name, row in CHANGES.items():
        ends = []
        for end in (0, 1):
            given = {key: pair[end] for key, pair in row.items()}
            if name == "grip_patch":
                given.update({"x": 1.0, "y": 0.0})
            ends.append(np.median(moved(plain, run(commands, **{name: given}))))
        assert max(ends) > 3.0


@pytest.mark.slow
@pytest.mark.parametrize("name", UNKNOWNS)
def test_unknown_moves_the_car(name: str) -> None:
    """The severe size moves a 1 s drive, size zero moves nothing; sensors leave the motion."""
    plain = plain_drive()
    sizes = np.repeat([0.0, *UNKNOWNS[name][:2]], 8)
    tripled = {key: np.concatenate([value] * 3) for key, value in DRAWN.items()}
    result = drive(RallyCar(tripled, unknown={name: sizes}), weave(100))
    parts = [
        {key: value[:, row : row + 8] for key, value in result.items() if key != "last"}
        for row in (0, 8, 16)
    ]
    for key in ("pose", "velocity", "shown_pose", "shown_velocity"):
        assert np.array_equal(plain[key], parts[0][key])
    assert np.array_equal(plain["pose"], parts[2]["pose"]) == (name in SENSORS)
    _low, high = (moved(plain, part) for part in parts[1:])
    assert np.median(high) > 3.0
    assert np.isfinite(high).all()


@pytest.mark.slow
def test_unknowns_stay_bounded() -> None:
    """All effects together at full size, 4 s of random commands: finite and bounded."""
    car = RallyCar(DRAWN, unknown={name: row[1] for name, row in UNKNOWNS.items()})
    commands = np.repeat(np.random.default_rng(4).uniform(-1, 1, (20, 2)), 20, axis=0)
    result = drive(car, commands, speed=1.0)
    assert all(np.isfinite(value).all() for value in result["last"].values())
    assert np.abs(result["velocity"][..., :2]).max() < 10.0


@pytest.mark.slow
@pytest.mark.parametrize("name", MOVING)
def test_unknown_makes_no_energy(name: str) -> None:
    """A coasting car with a severe effect gains no lasting speed (external boards excepted)."""
    car = RallyCar(DRAWN, unknown={name: UNKNOWNS[name][1]})
    state = car.start(np.zeros(3), np.array([3.0, 0.5, 2.0]))
    first = car.energy(state)
    for _ in range(50):
        state = car.step(state, OFF)
    assert (car.energy(state) < first).all()


def test_wrong_names_are_refused() -> None:
    """Unknown names raise."""
    with pytest.raises(ValueError, match="unknown change or argument: grip"):
        RallyCar(DRAWN, {"grip": {"ratio": 1.0}})
    with pytest.raises(ValueError, match="that do not exist"):
        RallyCar(DRAWN, unknown={"nothing": 1.0})
