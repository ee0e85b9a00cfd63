"""TorchRL's collector with its state between two batches in the open."""

from tensordict import TensorDictBase
from torchrl.collectors import Collector


class ResumableCollector(Collector):
    """A collector whose run can be resumed: TorchRL's own `state_dict` leaves its state out."""

    @property
    def state(self) -> TensorDictBase:
        """From which the next batch begins; may be replaced by that of another run."""
        return self._carrier

    @state.setter
    def state(self, state: TensorDictBase) -> None:
        self._carrier = state
