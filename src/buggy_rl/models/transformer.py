"""Causal transformer over the history."""

import torch
from torch import Tensor, nn

from buggy_rl.models.base import INPUTS, DynamicsModel


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
