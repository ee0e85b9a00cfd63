"""Two minutes of driving a concealed car, and as much from before anything was wrong with it."""

from collections.abc import Sequence
from pathlib import Path

from buggy_rl.blind_test.case import Case
from buggy_rl.blind_test.measuring import measured
from buggy_rl.blind_test.motion import moved
from buggy_rl.recordings import save_recording

NOISE = 100  # first number of a baseline drive's noise, well behind those of the others


def recorded(case: Case, folder: Path) -> bool:
    """Whether a car's drives are all there."""
    return all(file.exists() for file in _files(case, folder))


def record(cases: Sequence[Case], folders: Sequence[Path]) -> None:
    """Drives cars, all at once, and writes `recordings/` and `baseline/` into each one's folder.

    Args:
        cases: Of one plant and length, with baseline drives.
        folders: Of each.
    """
    for case, folder, motion in zip(cases, folders, moved(cases), strict=True):
        assert motion.clean is not None
        drives = [measured(case, motion.changed[n], True, n) for n in range(case.drives)]
        drives += [measured(case, motion.clean[n], False, NOISE + n) for n in range(case.drives)]
        for drive, file in zip(drives, _files(case, folder), strict=True):
            file.parent.mkdir(parents=True, exist_ok=True)
            save_recording(drive, file)


def _files(case: Case, folder: Path) -> list[Path]:
    places = range(case.drives)
    # A name tells a drive from all others, also from those before the change.
    changed = [folder / "recordings" / f"drive_{place}.csv" for place in places]
    return changed + [folder / "baseline" / f"before_{place}.csv" for place in places]
