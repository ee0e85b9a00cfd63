"""Commands on their way to the engine: what is remembered of them, and filters."""

import math
from abc import abstractmethod
from typing import ClassVar

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn

from buggy_rl.core import keys
from buggy_rl.core.longitudinal import ONE_WAY_REST
from buggy_rl.task.transforms.base import TaskTransform, unbounded_spec

GIVEN = "_given"  # ends the key of u'_t, which is there while the step is taken and no longer


class CommandFilter(TaskTransform):
    """u'_t = f(u'_{t-1}, u_t) of both commands, u taken within [-1, 1].

    u'_0 is no drive and straight wheels. The data keep the policy's command u.

    Args:
        rest: Throttle without drive of the simulator, see `longitudinal`.
    """

    memory: ClassVar[str]
    """Key of u'_{t-1}, [*, 2]."""

    def __init__(self, rest: float = ONE_WAY_REST) -> None:
        super().__init__()
        self.rest = rest
        self.writes = {self.memory: unbounded_spec(2)}
        self.remembers = (self.memory,)

    @abstractmethod
    def _filtered(self, previous: Tensor, asked: Tensor) -> Tensor:
        """f, of tensors [*, 2]."""

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        previous = tensordict.get(self.memory)
        asked = tensordict.get(keys.ACTION).to(previous.dtype).clamp(-1.0, 1.0)
        action = self._filtered(previous, asked)
        # Not under the memory's own key: rewards still compare with the step before.
        tensordict.set(self.memory + GIVEN, action)
        return tensordict.set(keys.ACTION, action)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict.set(self.memory, tensordict.get(self.memory + GIVEN))

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        pose = next_tensordict.get(keys.POSE)
        resting = pose.new_tensor([self.rest, 0.0]).expand(*pose.shape[:-1], 2).clone()
        return next_tensordict.set(self.memory, resting)


class LastAction(CommandFilter):
    """u'_t = u_t within [-1, 1]. Nearer to the engine than a filter it records its output."""

    memory = keys.LAST_ACTION

    def _filtered(self, previous: Tensor, asked: Tensor) -> Tensor:
        return asked


class ActionSmoothing(CommandFilter):
    """u'_t = u'_{t-1} + (1 - exp(-dt / time_constant)) (u_t - u'_{t-1}).

    Args:
        time_constant: [s]
        dt: Control period [s].
        rest: Throttle without drive of the simulator.
    """

    memory = keys.SMOOTHED_ACTION

    def __init__(
        self, time_constant: float = 0.05, *, dt: float, rest: float = ONE_WAY_REST
    ) -> None:
        super().__init__(rest)
        if not time_constant > 0:
            raise ValueError(f"action_smoothing: time_constant is {time_constant}: must be above 0")
        self.share = 1.0 - math.exp(-dt / time_constant)

    def _filtered(self, previous: Tensor, asked: Tensor) -> Tensor:
        return torch.lerp(previous, asked, self.share)


class RateLimit(CommandFilter):
    """u'_t = u'_{t-1} + min(max(u_t - u'_{t-1}, -rate dt), rate dt).

    Args:
        throttle: Fastest change [1/s]; of the whole range, which is 2 wide.
        steering: Likewise.
        dt: Control period [s].
        rest: Throttle without drive of the simulator.
    """

    memory = keys.LIMITED_ACTION

    def __init__(
        self,
        throttle: float = 20.0,
        steering: float = 10.0,
        *,
        dt: float,
        rest: float = ONE_WAY_REST,
    ) -> None:
        super().__init__(rest)
        for name, value in (("throttle", throttle), ("steering", steering)):
            if not value > 0:
                raise ValueError(f"rate_limit: {name} is {value} a second: must be above 0")
        self.largest = nn.Buffer(
            torch.tensor([throttle * dt, steering * dt], dtype=torch.float32), persistent=False
        )

    def _filtered(self, previous: Tensor, asked: Tensor) -> Tensor:
        return previous + (asked - previous).clamp(-self.largest, self.largest)
