"""Actors and critics of one's own: made from a name, checked, driven without exploration."""

from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import ProbabilisticTensorDictSequential, TensorDictModuleBase
from torch import nn
from torchrl.envs.utils import ExplorationType, set_exploration_type

from buggy_rl.core import keys, trust
from buggy_rl.core.config import load_named, one_line

STATE_VALUE = "state_value"  # a critic's output
IS_INIT = "is_init"  # what TorchRL's recurrent modules call the first step of an episode


def make_actor(name: str, *given: Any) -> ProbabilisticTensorDictSequential:
    """An actor of one's own.

    Args:
        name: `path/to/file.py:factory` or `package.module:factory`, a function or class that
            returns a `ProbabilisticActor`.
        given: Its arguments: observation size and `PolicyConfig`.

    Raises:
        ValueError: It cannot be made, or does not write `action` with its log density.
    """
    actor = _made("policy.actor", name, ProbabilisticTensorDictSequential, given)
    needed = {keys.ACTION, *actor.log_prob_keys}
    missing = sorted(str(key) for key in needed - set(actor.out_keys))
    if missing:
        raise ValueError(
            f"policy.actor={name} does not write {', '.join(missing)}: give ProbabilisticActor "
            "return_log_prob=True and the out_keys [action]"
        )
    return actor


def make_critic(name: str, *given: Any) -> TensorDictModuleBase:
    """A critic of one's own: a module that writes `state_value` [*, 1].

    Args:
        name: As for `make_actor`.
        given: Likewise.

    Raises:
        ValueError: It cannot be made, does not write `state_value`, or is recurrent.
    """
    critic = _made("policy.critic", name, TensorDictModuleBase, given)
    if STATE_VALUE not in critic.out_keys:
        raise ValueError(
            f"policy.critic={name} writes {critic.out_keys}: it has to write {STATE_VALUE}"
        )
    if memory_of(critic):
        raise ValueError(
            f"policy.critic={name} is recurrent, but last states are valued without those "
            "before them: leave the memory to the actor"
        )
    return critic


def memory_of(module: nn.Module) -> list[Any]:
    """Keys of the recurrent state of a module, such as one with TorchRL's `GRUModule`; or none."""
    primers = [
        part.make_tensordict_primer()  # pyright: ignore[reportCallIssue]
        for part in module.modules()
        if hasattr(part, "make_tensordict_primer")
    ]
    return [key for primer in primers for key in primer.primers.keys(True, True)]


class OwnDriver(TensorDictModuleBase):
    """Writes `action` by an actor of one's own, without exploration.

    A recurrent state is kept here from call to call, and begins anew where `step_count` is 0: who
    drives it needs no transform for it in the stack.
    """

    def __init__(self, actor: TensorDictModuleBase) -> None:
        super().__init__()
        self.actor, self._remembered = actor, memory_of(actor)
        self.in_keys, self.out_keys = [keys.OBSERVATION], [keys.ACTION]
        self._memory: TensorDictBase | None = None

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes `action` [*, 2].

        Raises:
            ValueError: A recurrent actor is asked in the middle of an episode that it has not seen.
        """
        given = tensordict.copy()
        if self._remembered:
            self._remind(given)
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            done = self.actor(given)
        if self._remembered:
            self._memory = done.get("next").select(*self._remembered)
        return tensordict.set(keys.ACTION, done.get(keys.ACTION))

    def _remind(self, given: TensorDictBase) -> None:
        """Adds the recurrent state, and which environments begin an episode."""
        begins = given.get(keys.STEP_COUNT, None)
        if begins is None:
            raise ValueError("a recurrent actor needs the step counter: task.transforms.step_limit")
        begins = begins == 0
        given.set(IS_INIT, begins)
        if self._memory is not None and self._memory.batch_size == given.batch_size:
            given.update(self._memory)
        elif not torch.all(begins):
            raise ValueError("a recurrent actor has to drive an episode from its first step on")


def _made(setting: str, name: str, base: type, given: tuple[Any, ...]) -> Any:
    """What a factory returns for its arguments, which has to be of a class."""
    if ":" not in name:
        raise ValueError(f"{setting}={name}: must be file.py:factory or package.module:factory")
    factory = load_named(name)
    if isinstance(factory, type) or not callable(factory):
        trust.refuse_other_class(factory, base, name)
    try:
        made = factory(*given)
    except (TypeError, RuntimeError, KeyError, AttributeError) as error:
        raise ValueError(
            f"{setting}={name}(observation_size, config): {one_line(error)}"
        ) from error
    if not isinstance(made, base):
        raise ValueError(
            f"{setting}={name} returned an object of class {type(made).__name__}, expected a "
            f"{base.__name__}"
        )
    return made
