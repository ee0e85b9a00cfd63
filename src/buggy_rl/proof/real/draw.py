"""Cases from seeds, and the rule by which one is drawn again.

A recording of the edited half is given where every edit of the case can be seen in it (a column
that it needs varies) and no command has to leave its range; the others of the half are left out.
Where less than `least` seconds are left, half and sizes are drawn again, `TRIES` times at most, and
then the edits.
"""

import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from buggy_rl.proof.real.case import ENGINES, FAMILIES, RealCase
from buggy_rl.proof.real.dataset import SIDES, Dataset
from buggy_rl.proof.real.edits import EDITS, NAMED, UNKNOWN, Concealed, applicable, edited
from buggy_rl.recordings import Recording

FIRST = 3_000_000  # seeds begin here: no other case has one of them
TRIES = 20  # of half and sizes, for the same edits
ATTEMPTS = 50  # of edits


@dataclass(frozen=True)
class RealDrawConfig:
    """What is drawn from; what stands in a list twice is drawn twice as often."""

    first: int = 0
    """First seed."""
    cases: int = 280
    """Number of cases."""
    partitions: int = 2
    """Ways in which the recordings of a dataset are divided in halves, two halves each."""
    first_partition: int = 0
    """Number of the first of them: development cases are of other divisions than sealed ones."""
    families: list[str] = field(
        default_factory=lambda: ["nothing"] * 3 + ["one"] * 10 + ["two"] * 4 + ["unknown"] * 3
    )
    """How many edits, or one that the library has no effect for."""
    engines: list[str] = field(default_factory=lambda: list(ENGINES))
    """Simulators that are fitted to the other half."""
    edits: list[str] = field(default_factory=list)
    """Edits to draw from; empty for all."""
    given: list[bool] = field(default_factory=lambda: [True, True, False])
    """Whether the other half is given as a baseline."""
    least: float = 40.0
    """Least seconds of edited recordings."""

    def __post_init__(self) -> None:
        for what, chosen, known in (
            ("families", self.families, FAMILIES),
            ("engines", self.engines, ENGINES),
            ("edits", self.edits, EDITS),
        ):
            if unknown := sorted(set(chosen) - set(known)):
                raise ValueError(f"draw.{what}: no {unknown}; available: {', '.join(known)}")
        if self.partitions < 1:
            raise ValueError(f"draw.partitions is {self.partitions}: must be 1 at least")


def drawn(
    config: RealDrawConfig, datasets: Mapping[str, Dataset], secret: str = ""
) -> list[RealCase]:
    """The cases of a run, by seed.

    Args:
        config: What to draw from.
        datasets: By name.
        secret: Without it nobody can draw the same.
    """
    seeds = range(FIRST + config.first, FIRST + config.first + config.cases)
    return [draw(seed, config, datasets, secret) for seed in seeds]


def draw(
    seed: int, config: RealDrawConfig, datasets: Mapping[str, Dataset], secret: str = ""
) -> RealCase:
    """The case of one seed.

    Raises:
        ValueError: No edit of a family can be made in the recordings.
    """
    chance = random.Random(f"{secret}:{seed}")
    dataset = chance.choice([d for d in datasets.values() for _ in range(d.config.weight)])
    engine, given = chance.choice(config.engines), chance.choice(config.given)
    family = chance.choice(config.families)
    for _ in range(ATTEMPTS):
        names = _names(chance, family, config, dataset)
        for _ in range(TRIES):
            number = config.first_partition + chance.randrange(config.partitions)
            half = f"{number}{chance.choice(SIDES)}"
            concealed = {name: EDITS[name].drawn(chance) for name in sorted(names)}
            left = edited_half(dataset, half, concealed)
            if sum(recording.duration for recording in left) >= config.least:
                return RealCase(seed, dataset.name, half, engine, given, concealed)
    raise ValueError(
        f"seed {seed}: no edit of the family {family!r} leaves {config.least:g} s of a half of "
        f"{dataset.name}: give more recordings, or a smaller draw.least"
    )


def edited_half(dataset: Dataset, half: str, concealed: Concealed) -> list[Recording]:
    """The recordings of a half that can be edited, edited."""
    made = (
        edited(recording, concealed)
        for recording in dataset.half(half)
        if applicable(recording, list(concealed))
    )
    return [recording for recording in made if recording is not None]


def _names(
    chance: random.Random, family: str, config: RealDrawConfig, dataset: Dataset
) -> Sequence[str]:
    if family == "nothing":
        return ()
    able = [
        name
        for name in (UNKNOWN if family == "unknown" else NAMED)
        if (EDITS[name].speed_too or dataset.kind != "speed")
        and (not config.edits or name in config.edits)
    ]
    if not able:
        raise ValueError(f"draw.edits={config.edits}: none of them is of the family {family!r}")
    one = chance.choice(able)
    others = [name for name in able if EDITS[name].mechanism != EDITS[one].mechanism]
    if family != "two":
        return (one,)
    if not others:
        raise ValueError(f"draw.edits={config.edits}: no two of different mechanisms")
    return (one, chance.choice(others))
