"""Networks: perceptron, gated recurrent unit, temporal convolutions, causal transformer."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from buggy_rl.simulators.learned.base import INPUTS, DynamicsModel


class MLP(DynamicsModel):
    """Two hidden layers of 64 with ReLU6, over the flattened history."""

    def __init__(self, rows: int = 1, hidden: Sequence[int] = (64, 64)) -> None:
        super().__init__(rows)
        layers, width = [], rows * INPUTS
        for size in hidden:
            layers += [nn.Linear(width, size), nn.ReLU6()]
            width = size
        self.layers = nn.Sequential(*layers, nn.Linear(width, 3))

    def network(self, history: Tensor) -> Tensor:
        return self.layers(history.flatten(-2))


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


class CausalTransformer(DynamicsModel):
    """Pre-norm encoder layers with a causal mask and learned positions, read at the last row."""

    def __init__(self, rows: int = 20, width: int = 32, layers: int = 2, heads: int = 4) -> None:
        super().__init__(rows)
        self.embedding = nn.Linear(INPUTS, width)
        self.position = nn.Parameter(0.02 * torch.randn(rows, width))
        layer = nn.TransformerEncoderLayer(
            width, heads, 2 * width, dropout=0.0, batch_first=True, norm_first=True
        )
        self.encoder = nn.TransformerEncoder(layer, layers, enable_nested_tensor=False)
        self.head = nn.Linear(width, 3)
        mask = nn.Transformer.generate_square_subsequent_mask(rows)
        self.mask = nn.Buffer(mask, persistent=False)

    def network(self, history: Tensor) -> Tensor:
        sequences = history.reshape(-1, self.rows, INPUTS)
        tokens = self.embedding(sequences) + self.position  # (N, rows, width)
        # is_causal=True: the encoder does not inspect the mask, which would synchronise a GPU.
        encoded = self.encoder(tokens, mask=self.mask, is_causal=True)
        return self.head(encoded[:, -1]).view(*history.shape[:-2], 3)
