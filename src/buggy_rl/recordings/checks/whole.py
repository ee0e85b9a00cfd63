"""What is left of a drive after the cuts."""

import numpy as np

from buggy_rl.recordings.drive import Drive
from buggy_rl.recordings.limits import Limits


def check_left(drive: Drive, limits: Limits) -> None:
    """Enough of the drive is left.

    Raises:
        RecordingError: More than `cut_share` of the rows was cut, or too little time is left.
    """
    first = int(np.argmin(drive.keep))
    why = drive.notes[-1] if drive.notes else "nothing was cut"
    share = (~drive.keep & ~drive.repeated).sum() / (~drive.repeated).sum()
    if share > limits.cut_share:
        worst = f"{share:.0%} of the rows had to be cut, most recently: {why}"
        raise drive.refusal(first, "t", worst, "record again")
    lasting = [drive.t[s[-1]] - drive.t[s[0]] + drive.period for s in drive.stretches()]
    usable = sum(span for span in lasting if span >= limits.shortest_segment)
    if usable < limits.shortest_drive - 0.5 * drive.period:
        reason = f"{usable:.2f} s can be used, in stretches of {limits.shortest_segment} s or more"
        raise drive.refusal(
            *(first, "t", f"{reason} ({why})"),
            f"record {limits.shortest_drive:g} s or longer, or state the unit of time",
        )
