"""What a run of policy training asks of the algorithm that trains."""

from collections.abc import Iterator
from typing import Any, Protocol

from tensordict import TensorDictBase


class TrainerSettings(Protocol):
    """The block of a config that is named like its algorithm."""

    @property
    def steps(self) -> int:
        """Steps of all environments together."""
        ...

    @property
    def cars(self) -> int:
        """Environments stepped at once."""
        ...

    @property
    def batch(self) -> int:
        """Steps of all environments together between two rows of metrics."""
        ...


class Trainer(Protocol):
    """An algorithm at work on a policy; stopped after any batch it can be resumed."""

    steps: int
    """Steps so far."""

    def run(self) -> Iterator[dict[str, float]]:
        """Trains, and yields the metrics of every batch, `steps`, `reward`, `waypoints` among them.

        Raises:
            NonFiniteLossError: A loss is not finite.
        """
        ...

    def state_dict(self) -> dict[str, Any]:
        """Everything that a resumed run needs, as tensors and plain values."""
        ...

    def load_state_dict(self, state: dict[str, Any], /) -> None:
        """Goes back to where `state_dict` was taken."""
        ...


class NonFiniteLossError(FloatingPointError):
    """The loss is not a number any more.

    Args:
        message: What is wrong.
        batch: Rows that the loss was computed from.
        metrics: Row of the log of the batch that holds them; the means are over the minibatches up
            to the failed one.
    """

    def __init__(
        self, message: str, batch: TensorDictBase, metrics: dict[str, float] | None = None
    ) -> None:
        super().__init__(message)
        self.batch, self.metrics = batch, metrics or {}
