"""Classes of cases that are counted apart: by effect, pairing, nuisance, size, length, driving."""

from collections.abc import Callable, Iterable

from buggy_rl.blind_test.outcome import Outcome
from buggy_rl.blind_test.statistics import Figure, share

NATS = (10, 30, 100, 300, 1000, 10_000)  # bounds of the classes of detectability


def _detectability(o: Outcome) -> str:
    if o.nats is None:
        return "not weighed"
    place = sum(o.nats >= bound for bound in NATS)
    if place in (0, len(NATS)):
        return f"{place}: {'under' if not place else 'above'} {NATS[place and -1]} nats"
    return f"{place}: {NATS[place - 1]} to {NATS[place]} nats"


KEYS: dict[str, Callable[[Outcome], str]] = {
    "effect": lambda o: o.case.truth[0],
    "pairing": lambda o: o.case.pairing,
    "plant": lambda o: o.case.plant,
    "nuisance": lambda o: o.case.nuisance,
    "size": _detectability,
    "drive length": lambda o: f"{o.case.seconds:g} s",
    "driving": lambda o: o.case.driving,
}


def classes(
    outcomes: Iterable[Outcome], key: Callable[[Outcome], str]
) -> list[tuple[str, list[Outcome]]]:
    """Outcomes of each class, the classes in order."""
    found: dict[str, list[Outcome]] = {}
    for o in outcomes:
        found.setdefault(key(o), []).append(o)
    return sorted(found.items())


def right_by(outcomes: Iterable[Outcome], key: Callable[[Outcome], str]) -> dict[str, Figure]:
    """Share of first names that are right, of each class."""
    return {name: share([o.right for o in same]) for name, same in classes(outcomes, key)}
