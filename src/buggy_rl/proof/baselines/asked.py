"""What a method is asked: the question of a case, with all that it names opened."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import yaml

from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.diagnosis.run.case import segments_of
from buggy_rl.diagnosis.run.maker import Maker
from buggy_rl.effects.measuring import measurable_options
from buggy_rl.estimation.baseline import correct
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import Segments
from buggy_rl.recordings import Recording, load_recordings


@dataclass(frozen=True, eq=False)
class Asked:
    """Simulator and drives of a case."""

    config: DiagnosisConfig
    recordings: list[Recording]
    baseline: list[Recording]
    """Drives on which the simulator was right; empty where none are given."""

    def maker(self, parameters: Mapping[str, float] | None = None) -> Maker:
        """Builds the simulator for a number of environments, once for each number."""
        return Maker.of(self.config, parameters)

    @cached_property
    def corrected(self) -> Simulation:
        """Simulation of the simulator, with baseline recordings corrected as the diagnosis does it.

        What the simulator got wrong before anything changed is closed by the same small network
        (`correct`), so that a method sees what is left: what has changed.
        """
        make = self.maker()
        simulation = Simulation(make, options=measurable_options(make)[0])
        if not self.baseline:
            return simulation
        return correct(simulation, self.segments(self.baseline)).simulation(simulation)

    def segments(self, recordings: Sequence[Recording], most: int | None = None) -> Segments:
        """Segments of recordings as the question has them, `most` of them, spread evenly."""
        segments = segments_of(recordings, self.config)
        return segments if most is None else segments.spread(most)


@lru_cache(maxsize=1)
def open_question(seen: Path) -> Asked:
    """Opens the folder of what may be seen; the last one stays open, for the next method.

    Raises:
        ValueError: A drive cannot be read.
    """
    question = yaml.safe_load((seen / "question.yaml").read_text())
    for name in ("simulator", "columns", "car"):
        if name in question:
            question[name] = str(seen / question[name])
    config = DiagnosisConfig(**question, output="")
    return Asked(
        config,
        _drives(seen, config, config.recordings),
        _drives(seen, config, config.baseline),
    )


def _drives(seen: Path, config: DiagnosisConfig, names: Sequence[str]) -> list[Recording]:
    if not names:
        return []
    recordings, refusals = load_recordings(
        [str(seen / name) for name in names], config.columns or None, config.dt, car=config.car
    )
    if refusals or not recordings:
        raise ValueError(f"{seen}: {'; '.join(map(str, refusals)) or 'there are no drives'}")
    return recordings
