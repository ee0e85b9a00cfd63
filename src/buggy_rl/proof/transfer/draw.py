"""Cars of the study, drawn from a secret before any of them is driven."""

import hashlib
import random
from collections.abc import Iterator

from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.secret import publish_secret, secret_of
from buggy_rl.proof.cases.sizes import NAMED_SINCE, SIZES, UNKNOWN_SIZES

__all__ = ["drawn_cars", "publish_secret", "secret_of"]

CLASSES: dict[str, tuple[str, ...]] = {
    "steering": (
        *("steering_dead_time", "steering_offset", "steering_lag", "steering_rate_limit"),
        *("steering_gain", "steering_backlash", "steering_asymmetry", "servo_stiction"),
        *("steering_dead_zone", "steering_curve", "steering_end_stop", "steering_play"),
    ),
    "drive": (
        *("throttle_dead_time", "throttle_offset", "throttle_lag", "throttle_gain"),
        *("throttle_deadband", "voltage_sag", "thermal_foldback", "brown_out", "gear_ratio"),
        *("battery_sag", "motor_power_limit", "top_speed"),
    ),
    "resistance": (
        *("rolling_resistance", "viscous_drag", "cornering_drag", "steering_drag"),
        *("one_sided_drag", "aerodynamic_drag", "yaw_damping"),
    ),
    "tyres": ("cornering_stiffness", "tire_grip", "grip_balance", "grip_patch"),
    "body": (
        *("payload", "wind", "floor_slope", "understeer", "dive_steer"),
        *("torque_steer", "stiff_differential"),
    ),
    "unnamed": tuple(sorted(set(UNKNOWN_SIZES) - set(NAMED_SINCE))),
}
"""Class -> effects that a car can have; a car with two has them of different classes. Errors of the
camera are left out: on a car a policy is given the true motion with the camera's noise."""
FIRST_SEED = 700_000_000  # of cars: no case of scripts/prove.py has it
ROOM = 1_000  # cars of a study at most: seeds of two cars differ by their number


def drawn_cars(
    count: int,
    secret: str,
    control_every: int = 10,
    spread: float = 0.1,
    drives: int = 4,
    seconds: float = 30.0,
) -> dict[str, Case]:
    """Reference cars by their number, 01 and on, with what is concealed in each.

    More cars leave those before them as they are.

    Args:
        count: Number of cars.
        secret: Without it nobody can draw the same.
        control_every: Every so many cars one has nothing wrong.
        spread: Share by which each parameter of a car is drawn off its own, at most.
        drives: Drives after the change, and as many before it.
        seconds: Length of each [s].
    """
    chance = random.Random(f"cars {secret}")
    classes, sizes = _classes(chance), _sizes(chance)
    cars = {}
    for number in range(1, count + 1):
        concealed: dict[str, dict[str, float]] = {}
        if number % control_every:
            named = [chance.choice(CLASSES[next(classes)]) for _ in range(next(sizes))]
            concealed = {name: _numbers(chance, name) for name in sorted(named)}
        cars[f"{number:02d}"] = Case(
            _seed(secret, number),
            "reference",
            "single_track_fitted",
            baseline=True,
            concealed=concealed,
            seconds=seconds,
            drives=drives,
            held_out=0,
            spread=spread,
        )
    return cars


def _classes(chance: random.Random) -> Iterator[str]:
    """Every class once in each round, never the same twice in a row."""
    last = ""
    while True:
        deck = list(CLASSES)
        chance.shuffle(deck)
        if deck[0] == last:
            deck.append(deck.pop(0))
        last = deck[-1]
        yield from deck


def _sizes(chance: random.Random) -> Iterator[int]:
    """How many effects are concealed: one and two, as often."""
    while True:
        yield from chance.sample((1, 2), 2)


def _numbers(chance: random.Random, effect: str) -> dict[str, float]:
    values = {}
    for name, (low, high, signed, _) in (SIZES | UNKNOWN_SIZES)[effect].items():
        side = -1 if signed and chance.random() < 0.5 else 1
        values[name] = round(side * chance.uniform(low, high), 4)
    return values


def _seed(secret: str, number: int) -> int:
    """Seed of a car's parameters, drivers and camera."""
    drawn = int(hashlib.sha256(f"{secret}:{number}".encode()).hexdigest(), 16) % 100_000
    return FIRST_SEED + ROOM * drawn + number
