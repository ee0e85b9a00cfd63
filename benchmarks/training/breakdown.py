"""Where the time of our training goes, part by part."""

import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from typing import Any

import torch
from tensordict import TensorDict
from torch import nn
from torchrl.envs import Compose, TransformedEnv

from training.cases import Ours
from training.timing import WARM_UP


class Stopwatches:
    """Time by label; what runs within a labelled call under a label of its own counts there."""

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self.clock = clock
        self.spent: dict[str, float] = defaultdict(float)
        self._running: list[str] = ["the rest"]
        self._last = clock()
        self._before: list[tuple[Any, str, Any]] = []

    def wrap(self, holder: Any, name: str, label: str) -> None:
        """Times every call of a method from now on.

        Raises:
            AttributeError: There is no such method: the code that is measured has changed.
        """
        inner = getattr(holder, name)
        settable = isinstance(getattr(type(holder), name, None), property)
        self._before.append((holder, name, inner if settable else vars(holder).get(name)))

        def timed(*args: Any, **kwargs: Any) -> Any:
            self._count()
            self._running.append(label)
            try:
                return inner(*args, **kwargs)
            finally:
                self._count()
                self._running.pop()

        setattr(holder, name, timed)

    def unwrap(self) -> None:
        """Leaves all methods as they were."""
        for holder, name, own in reversed(self._before):
            delattr(holder, name) if own is None else setattr(holder, name, own)

    def begin(self) -> None:
        """Forgets what was counted so far."""
        self.spent.clear()
        self._last = self.clock()

    def _count(self) -> None:
        now = self.clock()
        self.spent[self._running[-1]] += now - self._last
        self._last = now


def breakdown(
    training: Ours, seconds: float, clock: Callable[[], float] = time.perf_counter
) -> dict[str, float]:
    """Microseconds a step of one car, by part; they add up to the whole loop's."""
    watches = Stopwatches(clock)
    for holder, name, label in parts(training):
        watches.wrap(holder, name, label)
    batches, first, begin = 0, 0, 0.0
    found: dict[str, float] = {}

    def watch(steps: int) -> bool:
        nonlocal batches, first, begin, found
        if batches == WARM_UP:
            first, begin = steps, time.perf_counter()
            watches.begin()
        batches += 1
        if batches <= WARM_UP + 1 or time.perf_counter() - begin < seconds:
            return True
        watches._count()
        found = {label: 1e6 * t / (steps - first) for label, t in watches.spent.items()}
        return False

    try:
        training.train(watch)
    finally:
        watches.unwrap()
    return dict(sorted(found.items(), key=lambda item: -item[1]))


def parts(training: Ours) -> Iterator[tuple[Any, str, str]]:
    """What is timed, as holder, method and label."""
    ppo = training.ppo
    env = ppo.env
    assert isinstance(env, TransformedEnv)
    yield ppo.collector, "rollout", "collector's loop"
    yield TensorDict, "maybe_dense_stack", "stacking steps to a batch"
    yield ppo.collector, "_wrapped_policy", "actor"
    yield env, "step_and_maybe_reset", "TorchRL's step and partial reset"
    for name in ("_step", "_reset"):
        yield env.base_env, name, "engine"
    stack = env.transform
    assert isinstance(stack, Compose)
    for transform in stack.transforms:
        for name in ("_step", "_inv_call", "_reset", "_reset_env_preprocess"):
            yield transform, name, f"transform {type(transform).__name__}"
    yield ppo, "_update", "minibatches: order, indexing"
    yield ppo, "estimate", "advantages, with the critic"
    yield ppo, "_descend", "gradient step: the rest"
    yield ppo.loss, "forward", "loss, forward"
    yield torch.Tensor, "backward", "loss, backward"
    yield nn.utils, "clip_grad_norm_", "gradient norm"
    yield ppo.optimiser, "step", "optimiser"
    yield ppo.policy, "observe", "observation scaling"
    yield ppo.episodes, "take", "episode statistics"
