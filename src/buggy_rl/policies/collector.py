"""TorchRL's collector with its state between two batches in the open."""

from tensordict import TensorDictBase
from torch import nn
from torchrl.collectors import Collector
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType


class ResumableCollector(Collector):
    """A collector whose run can be resumed: TorchRL's own `state_dict` leaves its state out."""

    @property
    def state(self) -> TensorDictBase:
        """From which the next batch begins; may be replaced by that of another run."""
        return self._carrier

    @state.setter
    def state(self, state: TensorDictBase) -> None:
        self._carrier = state


def in_process(env: EnvBase, actor: nn.Module, frames: int) -> ResumableCollector:
    """Steps environments in this process, `frames` of all together a batch, without an end."""
    return ResumableCollector(
        env,
        actor,
        frames_per_batch=frames,
        total_frames=-1,
        exploration_type=ExplorationType.RANDOM,  # pyright: ignore[reportArgumentType]
        trust_policy=True,
        track_traj_ids=False,
        use_buffers=False,
        return_same_td=True,  # nothing of a batch is kept: no copy is needed
        auto_register_policy_transforms=False,
    )
