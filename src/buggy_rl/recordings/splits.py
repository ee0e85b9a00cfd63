"""Training and held-out recordings."""

import zlib
from collections.abc import Sequence

from buggy_rl.recordings.recording import Recording


def split(
    recordings: Sequence[Recording], held_out: Sequence[str] | float, seed: int = 0
) -> tuple[list[Recording], list[Recording]]:
    """Splits by whole recordings into (training, held out).

    Args:
        recordings: All recordings.
        held_out: Names of the recordings to hold out, or their share (at least one recording).
        seed: Selects the recordings of a share; the choice depends on the names, not their order.

    Raises:
        ValueError: A name does not exist, or one side would be empty.
    """
    names = [r.name for r in recordings]
    if isinstance(held_out, (int, float)):
        order = sorted(names, key=lambda name: zlib.crc32(f"{seed}:{name}".encode()))
        chosen = set(order[: max(1, round(held_out * len(names)))])
    else:
        chosen = set(held_out)
        missing = sorted(chosen - set(names))
        if missing:
            raise ValueError(f"cannot hold out {missing}; available recordings: {sorted(names)}")
    training = [r for r in recordings if r.name not in chosen]
    held = [r for r in recordings if r.name in chosen]
    if not training or not held:
        raise ValueError(
            f"{len(names)} recording(s) cannot be split into training and held out: record more"
        )
    return training, held
