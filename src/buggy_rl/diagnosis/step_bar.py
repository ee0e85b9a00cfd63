"""A progress bar of a diagnosis, in time."""

from typing import Self

from buggy_rl.diagnosis.meter import Reading
from buggy_rl.jobs.bar import tqdm

FORMAT = "{elapsed} {desc}{postfix}"  # before there is a plan
PLANNED = "{elapsed} {desc} {percentage:3.0f}%|{bar}|{postfix}"


class StepBar:
    """What is being done, the share of the time that has passed, steps, and the time left."""

    def __init__(self) -> None:
        self._bar = tqdm(bar_format=FORMAT)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()

    def says(self, text: str) -> None:
        """What is being done."""
        self._bar.set_description_str(text)

    def show(self, reading: Reading) -> None:
        """How far it is."""
        self._bar.bar_format = PLANNED
        self._bar.total, self._bar.n = 1.0, reading.share
        done, planned = (tqdm.format_sizeof(n) for n in (reading.done, reading.planned))
        self._bar.set_postfix_str(f"{done}/{planned} steps, about {in_words(reading.left)} left")


def in_words(seconds: float) -> str:
    """A time to the precision of an estimate.

    >>> in_words(42.0), in_words(200.0)
    ('40 s', '3 min')
    """
    if seconds < 90:
        return f"{10 * max(1, round(seconds / 10)):.0f} s"
    return f"{seconds / 60:.0f} min"
