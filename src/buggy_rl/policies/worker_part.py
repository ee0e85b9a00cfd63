"""The part of the environments that one process of a distributed collector steps."""

import os
import threading
import time
from dataclasses import dataclass, field

import torch
from tensordict import TensorDictBase
from torchrl.data import Composite, TensorSpec, Unbounded
from torchrl.envs import EnvBase, StepCounter, Transform, TransformedEnv

from buggy_rl import keys
from buggy_rl.task.env import TaskConfig, make_env, make_simulator

PART = "collector_part"
"""Key of the number of the process that stepped an environment."""


class PartOfMany(Transform):
    """Writes which process an environment belongs to, and staggers its first episodes.

    Args:
        number: Of the process.
        limit: Longest age of a first episode [steps]; 0 leaves all at 0.
        seed: Of the ages.
    """

    def __init__(self, number: int, limit: int, seed: int) -> None:
        super().__init__()
        self.number, self.limit = number, limit
        self._ages = torch.Generator().manual_seed(seed)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        if self.limit:
            age = tensordict_reset[keys.STEP_COUNT]
            age.copy_(torch.randint(self.limit, age.shape, generator=self._ages))
            self.limit = 0  # later episodes begin at age 0
        return self._marked(tensordict_reset)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._marked(next_tensordict)

    def _marked(self, tensordict: TensorDictBase) -> TensorDictBase:
        shape = (*tensordict.batch_size, 1)
        return tensordict.set(PART, torch.full(shape, self.number, device=tensordict.device))

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Adds the number."""
        assert isinstance(observation_spec, Composite)
        shape = torch.Size([*observation_spec.shape, 1])
        observation_spec[PART] = Unbounded(shape, dtype=torch.int64, device=observation_spec.device)
        return observation_spec


@dataclass(frozen=True)
class PartMaker:
    """Makes the environments of one process there; can be pickled."""

    simulator: str
    parameters: dict
    options: dict
    task: TaskConfig
    cars: int
    """Environments of this process."""
    stagger: bool
    seed: int
    """Of the run; each process draws from its own."""
    number: int
    """Of the process."""
    driver: int = field(default_factory=os.getpid)
    """Process that asked for them."""

    def __call__(self) -> EnvBase:
        """The environments, in a process with one PyTorch thread."""
        if os.getpid() != self.driver:
            threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
        torch.set_num_threads(1)
        seed = 1000 * self.seed + self.number
        torch.manual_seed(seed)
        engine = make_simulator(
            self.simulator, self.cars, parameters=self.parameters, **self.options
        )
        env = make_env(engine, task=self.task)
        limits = [part.max_steps for part in env.modules() if isinstance(part, StepCounter)]
        limit = min((limit for limit in limits if limit), default=0) if self.stagger else 0
        return TransformedEnv(env, PartOfMany(self.number, limit, seed))


def _end_with(parent: int) -> None:
    """Ends this process when its parent has: an `rpc` worker waits for a killed one for ever."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)
