"""Cars of the study, drawn from a secret before any of them is driven."""

import hashlib
import random
from collections.abc import Iterator

from buggy_rl.proof.cases import classes
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.sizes import (
    CAMERA,
    COMMANDED_SIZES,
    NAMED_SINCE,
    SIZES,
    UNKNOWN_SIZES,
)

CLASSES = {
    name: able
    for name, effects in classes.CLASSES.items()
    if (able := tuple(e for e in effects if e not in CAMERA and e not in COMMANDED_SIZES))
} | {"unnamed": tuple(sorted(set(UNKNOWN_SIZES) - set(NAMED_SINCE)))}
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
    decks, sizes = _classes(chance), _sizes(chance)
    cars = {}
    for number in range(1, count + 1):
        concealed: dict[str, dict[str, float]] = {}
        if number % control_every:
            named = [chance.choice(CLASSES[next(decks)]) for _ in range(next(sizes))]
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
    sizes = (SIZES | UNKNOWN_SIZES)[effect]
    return {name: size.drawn(chance) for name, size in sizes.items()}


def _seed(secret: str, number: int) -> int:
    """Seed of a car's parameters, drivers and camera."""
    drawn = int(hashlib.sha256(f"{secret}:{number}".encode()).hexdigest(), 16) % 100_000
    return FIRST_SEED + ROOM * drawn + number
