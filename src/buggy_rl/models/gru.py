"""Gated recurrent unit over the history."""

from torch import Tensor, nn

from buggy_rl.models.base import INPUTS, DynamicsModel


class GRU(DynamicsModel):
    """One recurrent layer over the whole history, read out at the last row."""

    def __init__(self, rows: int = 20, hidden: int = 48) -> None:
        super().__init__(rows)
        self.recurrent = nn.GRU(INPUTS, hidden, batch_first=True)
        self.head = nn.Linear(hidden, 3)

    def network(self, history: Tensor) -> Tensor:
        sequences = history.reshape(-1, self.rows, INPUTS)
        states, _ = self.recurrent(sequences)  # (N, rows, hidden)
        return self.head(states[:, -1]).view(*history.shape[:-2], 3)
