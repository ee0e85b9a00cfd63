"""What the loop and its watchdog say to one another, as fixed bytes."""

import struct
from typing import NamedTuple

COMMAND = struct.Struct("<Qdddq")
REPORT = struct.Struct("<Qdddqq")
STATES = (
    "",
    "no fresh command reached the watchdog",
    "the actuator does not take commands",
    "the loop is late again and again",
    "the watchdog was told to end, or has an error",
)
GOOD, SILENT, FAILING, LATE, ENDING = range(5)  # indices of `STATES`
REFUSED, TAKEN, READ_BACK = 0, 1, 2  # what became of a write


class CommandMessage(NamedTuple):
    """Message from the loop, once a step."""

    sequence: int
    """Counts up from 1; an older one is ignored."""
    stamp: float
    """Time at which the loop decided [s]."""
    throttle: float
    steering: float
    last: int = 0
    """1: the drive is over; write neutral and exit."""

    def pack(self) -> bytes:
        """Packs the message as bytes."""
        return COMMAND.pack(*self)


class Report(NamedTuple):
    """Message from the watchdog, after each attempt to write."""

    sequence: int
    """Sequence number of the last command heard."""
    stamp: float
    """Time at which the actuator had taken or refused it [s]."""
    throttle: float
    """Throttle as written, or as it could not be."""
    steering: float
    taken: int
    """`TAKEN`, `READ_BACK` if the board was asked as well, `REFUSED` if it did not take it."""
    state: int
    """`GOOD`, or why the wheels are kept neutral: one of the others."""

    def pack(self) -> bytes:
        """Packs the report as bytes."""
        return REPORT.pack(*self)


def read_command(message: bytes) -> CommandMessage:
    """The command in a message.

    Raises:
        ValueError: It has another length.
    """
    return CommandMessage(*_unpacked(COMMAND, message))


def read_report(message: bytes) -> Report:
    """The report in a message.

    Raises:
        ValueError: It has another length.
    """
    return Report(*_unpacked(REPORT, message))


def _unpacked(layout: struct.Struct, message: bytes) -> tuple:
    if len(message) != layout.size:
        raise ValueError(f"a message of {len(message)} bytes: expected {layout.size}")
    return layout.unpack(message)
