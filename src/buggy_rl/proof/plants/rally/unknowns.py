"""Table of the unknown effects and their construction."""

from buggy_rl.proof.plants.rally.arrays import Array, Arrays
from buggy_rl.proof.plants.rally.unknown_base import Unknown
from buggy_rl.proof.plants.rally.unknown_body import BODY
from buggy_rl.proof.plants.rally.unknown_drive import DRIVE
from buggy_rl.proof.plants.rally.unknown_sensor import SENSOR
from buggy_rl.proof.plants.rally.unknown_steer import STEER
from buggy_rl.proof.plants.rally.unknown_tyre import TYRE
from buggy_rl.proof.plants.rally.unknown_wheel import WHEEL

_KINDS: dict[str, type[Unknown]] = {
    kind.name: kind for group in (TYRE, WHEEL, DRIVE, STEER, BODY, SENSOR) for kind in group
}

# name -> (barely noticeable, severe, mechanism); size 0 switches an effect off exactly.
UNKNOWNS: dict[str, tuple[float, float, str]] = {
    name: (kind.low, kind.high, kind.mechanism) for name, kind in _KINDS.items()
}


def make_unknowns(sizes: dict[str, Array], k: Arrays) -> list[Unknown]:
    """Effects in the order of the table.

    Args:
        sizes: Name -> [N].
        k: Constants of the cars.

    Raises:
        ValueError: There is no such effect.
    """
    wrong = set(sizes) - set(_KINDS)
    if wrong:
        raise ValueError(f"unknown effects that do not exist: {sorted(wrong)}")
    return [kind(sizes[name], k) for name, kind in _KINDS.items() if name in sizes]
