"""Edits of real recordings: what turns one into that of the same car with an effect."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.proof.real.edits.base import (
    VARIES,
    Edit,
    LogRows,
    command_spread,
    log_rows,
    to_tensor,
)
from buggy_rl.proof.real.edits.sensor import (
    GyroBiasEdit,
    SensorLeverArmEdit,
    SensorYawEdit,
    SpeedScaleEdit,
)
from buggy_rl.proof.real.edits.steering import (
    SteeringAsymmetryEdit,
    SteeringBacklashEdit,
    SteeringGainEdit,
    SteeringOffsetEdit,
)
from buggy_rl.proof.real.edits.throttle import (
    BatterySagEdit,
    ThrottleDeadbandEdit,
    ThrottleGainEdit,
)
from buggy_rl.proof.real.edits.timing import (
    SensorLatencyEdit,
    SteeringDeadTimeEdit,
    ThrottleDeadTimeEdit,
)
from buggy_rl.proof.real.edits.unknown import (
    CrossTalkEdit,
    HeldLogEdit,
    PeriodicDeadTimeEdit,
    QuantisedLogEdit,
    SteeringExponentEdit,
    ThrottleExponentEdit,
)
from buggy_rl.recordings import Recording

# From the engine outwards, as the library's effects stand: the nearest is undone first.
EDITS: dict[str, Edit] = {
    edit.name: edit
    for edit in (
        BatterySagEdit(),
        ThrottleGainEdit(),
        ThrottleDeadbandEdit(),
        ThrottleExponentEdit(),
        ThrottleDeadTimeEdit(),
        CrossTalkEdit(),
        SteeringOffsetEdit(),
        SteeringGainEdit(),
        SteeringAsymmetryEdit(),
        SteeringExponentEdit(),
        SteeringBacklashEdit(),
        SteeringDeadTimeEdit(),
        QuantisedLogEdit(),
        HeldLogEdit(),
        PeriodicDeadTimeEdit(),
        SensorLatencyEdit(),
        SensorLeverArmEdit(),
        SensorYawEdit(),
        SpeedScaleEdit(),
        GyroBiasEdit(),
    )
}
NAMED = tuple(name for name, edit in EDITS.items() if edit.known)
UNKNOWN = tuple(name for name, edit in EDITS.items() if not edit.known)
SHORTEST = 0.5  # [s] shorter parts are dropped
FULL = 1 + 1e-9  # [command] largest size of an edited command, but for rounding

Concealed = Mapping[str, Mapping[str, float]]
"""Edit -> parameter -> value."""


def applicable(recording: Recording, names: Sequence[str]) -> bool:
    """Whether edits can be seen in a recording: the columns that they need vary."""
    kind = recording.command.kind
    return all(
        (edit.speed_too or kind != "speed")
        and (not edit.varies or command_spread(recording, edit.varies) >= VARIES)
        for edit in (EDITS[name] for name in names)
    )


def edited(recording: Recording, concealed: Concealed) -> Recording | None:
    """A recording of the same car with what is concealed.

    Args:
        recording: Untouched; sensors beside the tracker are left out.
        concealed: What the car has.

    Returns:
        None where a command would have to be outside its range, or nothing is left.
    """
    kept = []
    for part in log_rows(recording):
        for name, edit in EDITS.items():
            if name in concealed:
                part = edit.edited(part, concealed[name])
        commands = np.concatenate([part.throttle, part.steering])
        if np.abs(commands).max(initial=0.0) > FULL:
            return None
        if len(part) >= SHORTEST / part.dt:
            kept.append(part)
    return replace(recording, data=_joined(kept), notes=[], derived=()) if kept else None


def _joined(parts: Sequence[LogRows]) -> TensorDict:
    rows = sum(len(part) for part in parts)
    action = [np.stack([part.throttle, part.steering], -1).clip(-1, 1) for part in parts]
    number = [np.full(len(part), place) for place, part in enumerate(parts)]
    return TensorDict(
        {
            keys.TIME: torch.as_tensor(np.concatenate([p.t for p in parts])[:, None]),
            keys.POSE: to_tensor(np.concatenate([p.pose for p in parts])),
            keys.VELOCITY: to_tensor(np.concatenate([p.velocity for p in parts])),
            keys.ACTION: to_tensor(np.concatenate(action)),
            keys.SEGMENT: torch.as_tensor(np.concatenate(number)),
        },
        [rows],
    )
