"""Multilayer perceptron, with or without history (original study, 6.5.1 and 6.5.2)."""

from collections.abc import Sequence

from torch import Tensor, nn

from buggy_rl.models.base import INPUTS, DynamicsModel


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
