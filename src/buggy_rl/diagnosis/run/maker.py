"""Builds the simulator that is diagnosed, here and in worker processes."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from torchrl.envs import EnvBase

from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.simulators import ENGINES, Factory, read_simulator
from buggy_rl.task.env import make_simulator


@dataclass(frozen=True)
class Maker:
    """Builds a simulator for a number of environments, once for each number."""

    simulator: str | Factory
    """Any engine, .yaml, .pt or file.py:factory, or a factory itself."""
    parameters: Mapping[str, float] | None = None
    """Parameters of the simulator, where they are not as its file says."""
    options: Mapping[str, Any] = field(default_factory=dict)
    _built: dict[int, EnvBase] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of(
        cls,
        config: DiagnosisConfig,
        parameters: Mapping[str, float] | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> "Maker":
        """Builds the simulator of a question, with further parameters and options."""
        engine = engine_of(config.simulator)
        threads: dict[str, Any] = {"nthread": config.threads} if engine == "mujoco" else {}
        own = {**threads, **own_options(config), **(options or {})}
        return cls(config.simulator, parameters, own)

    def __call__(self, count: int) -> EnvBase:
        if count not in self._built:
            self._built[count] = make_simulator(
                self.simulator, count, parameters=self.parameters, **self.options
            )
        return self._built[count]

    def __getstate__(self) -> dict[str, Any]:
        """What another process needs to build it anew."""
        return {**vars(self), "_built": {}}


def own_options(config: DiagnosisConfig) -> dict[str, Any]:
    """Options of an engine of ours that a question says; a user's own factory takes none."""
    engine, own = engine_of(config.simulator), dict[str, Any]()
    if engine in ENGINES or engine.endswith(".pt"):
        own |= {} if config.dt == CONTROL_PERIOD else {"dt": config.dt}
    if config.car and str(config.simulator) in ENGINES:  # a file says itself which car it is
        own["car"] = config.car
    return own


def engine_of(simulator: str | Factory) -> str:
    """The engine of a simulator file; none of a factory."""
    if callable(simulator):
        return ""
    while simulator.endswith((".yaml", ".yml")):
        simulator = str(read_simulator(Path(simulator))["engine"])
    return simulator
