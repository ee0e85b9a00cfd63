"""Temporal convolutions over the history (original study, 6.5.3)."""

from torch import Tensor, nn

from buggy_rl.models.base import INPUTS, DynamicsModel

REACH = 18  # [rows] receptive field of an output: 4 + 2 * (4 - 1) + 4 * (3 - 1)


class TemporalCNN(DynamicsModel):
    """Channels 5-8-12-16, kernels 4-4-3, strides 2-2-1: 20 rows shrink to 9, 3 and 1; then 16-3.

    The strides do not divide 20 rows: two at one end reach no output. In the original study these
    are the two newest, the present command included; here they are the two oldest.
    """

    def __init__(self, rows: int = 20) -> None:
        super().__init__(rows)
        self.convolutions = nn.Sequential(
            nn.Conv1d(INPUTS, 8, 4, stride=2),
            nn.ReLU6(),
            nn.Conv1d(8, 12, 4, stride=2),
            nn.ReLU6(),
            nn.Conv1d(12, 16, 3),
            nn.ReLU6(),
        )
        if rows < REACH:
            raise ValueError(f"temporal_cnn: rows is {rows}; needs at least {REACH} rows")
        left = (rows - REACH) // 4 + 1  # length after the three convolutions
        self.unused = (rows - REACH) % 4  # oldest rows, which reach no output
        self.head = nn.Sequential(nn.Linear(16 * left, 16), nn.ReLU6(), nn.Linear(16, 3))

    def network(self, history: Tensor) -> Tensor:
        channels = history.flatten(0, -3) if history.dim() > 2 else history.unsqueeze(0)
        features = self.convolutions(channels[:, self.unused :].transpose(-1, -2))  # (N, 16, left)
        return self.head(features.flatten(1)).view(*history.shape[:-2], 3)
