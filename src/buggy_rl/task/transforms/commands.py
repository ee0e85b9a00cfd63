"""Base class of filters of the command, which remember their last output."""

from abc import abstractmethod
from typing import ClassVar

from tensordict import TensorDictBase
from torch import Tensor

from buggy_rl import keys
from buggy_rl.longitudinal import ONE_WAY_REST
from buggy_rl.task.transforms.base import TaskTransform, numbers

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
        self.writes = {self.memory: numbers(2)}

    @abstractmethod
    def _filtered(self, previous: Tensor, asked: Tensor) -> Tensor:
        """f, of tensors [*, 2]."""

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        asked = tensordict.get(keys.ACTION).clamp(-1.0, 1.0)
        action = self._filtered(tensordict.get(self.memory), asked)
        # Not under the memory's own key: rewards still compare with the step before.
        tensordict.set(self.memory + GIVEN, action)
        return tensordict.set(keys.ACTION, action)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict.set(self.memory, tensordict.get(self.memory + GIVEN))

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        pose = next_tensordict.get(keys.POSE)
        resting = pose.new_tensor([self.rest, 0.0]).expand(*pose.shape[:-1], 2).clone()
        return next_tensordict.set(self.memory, resting)
