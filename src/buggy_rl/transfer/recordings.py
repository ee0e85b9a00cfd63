"""Recordings of a concealed car, and of the same car before the change."""

from collections.abc import Sequence
from pathlib import Path

from buggy_rl.blind_test.case import Case
from buggy_rl.blind_test.drives import moved
from buggy_rl.blind_test.recorded import BASELINE_NOISE, save_drives


def recorded(case: Case, folder: Path) -> bool:
    """Whether a car's recordings are all there."""
    kinds = {"recordings": "drive", "baseline": "before"}
    return all(
        (folder / kind / f"{name}_{number}.csv").exists()
        for kind, name in kinds.items()
        for number in range(case.drives)
    )


def record(cases: Sequence[Case], folders: Sequence[Path]) -> None:
    """Drives cars in one batch and writes `recordings/` and `baseline/` into the folder of each.

    The cases are of one plant and length, with baseline drives.
    """
    for case, folder, motion in zip(cases, folders, moved(cases), strict=True):
        assert motion.clean is not None
        changed = {f"drive_{n}": n for n in range(case.drives)}
        before = {f"before_{n}": BASELINE_NOISE + n for n in range(case.drives)}
        save_drives(case, motion.changed[: case.drives], folder / "recordings", changed)
        save_drives(case, motion.clean, folder / "baseline", before, changed=False)
