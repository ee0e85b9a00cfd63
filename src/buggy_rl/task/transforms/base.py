"""Base classes of the task's transforms.

State that a transform needs from step to step is in the TensorDict under a key of its own, so that
a step is a function of its input. Only a reset draws random numbers: the path, the noise, the
target speed.
"""

from collections.abc import Iterable, Mapping

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, Composite, TensorSpec, Unbounded
from torchrl.envs import Transform

from buggy_rl.core import keys

COUNT = Bounded(0, torch.iinfo(torch.int64).max, torch.Size([1]), dtype=torch.int64)


class TaskTransform(Transform):
    """A transform that says what it reads and what it writes.

    `_call` works on what an engine returned, after a reset as after a step. One that needs the
    step before overrides `_step(td, next_td)`, and `_reset(td, td_reset)` with it.
    """

    reads: tuple[str, ...] = ()
    """Keys that must have been written by what stands before."""
    before: tuple[str, ...] = ()
    """Keys that only what stands behind may write."""
    writes: Mapping[str, TensorSpec] = {}
    """Keys that it writes, with their specs without the batch."""
    remembers: tuple[str, ...] = ()
    """Keys of `writes` that its next step reads: a reset that is given them goes on from there."""
    resets_alone: bool = True
    """Whether it takes sizes from the TensorDict, so that some environments reset by themselves."""

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        state = self._call(tensordict_reset)
        for key in self.remembers:
            given = tensordict.get(key, None)
            if given is not None:
                state.set(key, given)
        return state

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        self._check_place(observation_spec, self.writes)
        for key, spec in self.writes.items():
            observation_spec[key] = batched(spec, observation_spec)
        return observation_spec

    def transform_state_spec(self, state_spec: Composite) -> Composite:
        for key in self.remembers:
            state_spec[key] = batched(self.writes[key], state_spec)
        return state_spec

    def _check_place(self, promised: Composite, writes: Iterable[str]) -> None:
        name, written = type(self).__name__, set(map(str, promised.keys()))
        twice = sorted(written.intersection(writes) - {keys.MEASURED_POSE, keys.MEASURED_VELOCITY})
        if twice:
            raise ValueError(
                f"{name} stands twice in the stack ({', '.join(twice)} is already written): leave "
                "one of them out"
            )
        missing = [key for key in self.reads if key not in written]
        if missing:
            raise ValueError(
                f"{name} reads {', '.join(missing)}, which nothing before it writes: put the "
                "transform that does before it in the stack"
            )
        early = [key for key in self.before if key in written]
        if early:
            raise ValueError(
                f"{name} comes too late: {', '.join(early)} is already written; put it before "
                "the transform that does"
            )


class RandomTransform(TaskTransform):
    """A transform that draws random numbers at a reset, from `generator`.

    Until `env.set_seed` is called, `generator` is None and PyTorch's global generator is used, as
    by the policy: then `torch.manual_seed` fixes a run.
    """

    generator: torch.Generator | None = None


def batched(spec: TensorSpec, of: Composite) -> TensorSpec:
    """A spec without the batch as one of a Composite: with its batch, on its device."""
    return spec.expand(of.shape + spec.shape).to(of.device or "cpu")


def unbounded_spec(*sizes: int) -> Unbounded:
    """Spec of float32 numbers [*sizes]."""
    return Unbounded(torch.Size(sizes), dtype=torch.float32)


def measured_velocity(tensordict: TensorDictBase) -> Tensor:
    """Velocity [*, 3] as the sensing transforms so far left it."""
    return tensordict.get(keys.MEASURED_VELOCITY, tensordict.get(keys.VELOCITY))


def measured_pose(tensordict: TensorDictBase) -> Tensor:
    """Pose [*, 3] as the sensing transforms so far left it."""
    return tensordict.get(keys.MEASURED_POSE, tensordict.get(keys.POSE))
