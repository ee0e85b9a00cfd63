"""Builds the simulator that is diagnosed, here and in worker processes."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from torchrl.envs import EnvBase

from buggy_rl.engines import Factory
from buggy_rl.task.env import make_simulator


@dataclass(frozen=True)
class Maker:
    """Builds a simulator for a number of environments, once for each number."""

    simulator: str | Factory
    """Any engine, .yaml, .pt or file.py:factory, or a factory itself."""
    parameters: Mapping[str, float] | None = None
    """Of its own, where they are not as its file says."""
    options: Mapping[str, Any] = field(default_factory=dict)
    _built: dict[int, EnvBase] = field(default_factory=dict, repr=False, compare=False)

    def __call__(self, count: int) -> EnvBase:
        if count not in self._built:
            self._built[count] = make_simulator(
                self.simulator, count, parameters=self.parameters, **self.options
            )
        return self._built[count]

    def __getstate__(self) -> dict[str, Any]:
        """What another process needs to build it anew."""
        return {**vars(self), "_built": {}}
