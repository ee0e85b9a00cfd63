"""The policy's network in numpy: an observation to the mean command."""

from typing import Callable, Dict, Sequence, Tuple

import numpy as np


def _relu(values: np.ndarray) -> None:
    np.maximum(values, 0.0, out=values)


def _tanh(values: np.ndarray) -> None:
    np.tanh(values, out=values)


def _elu(values: np.ndarray) -> None:
    below = np.expm1(np.minimum(values, 0.0))
    np.copyto(values, below, where=values < 0)


ACTIVATIONS: Dict[str, Callable] = {"relu": _relu, "tanh": _tanh, "elu": _elu}


class Network:
    """u = W_n a(... a(W_1 s(o) + b_1) ...) + b_n,  s(o) = clip((o - mean) / sd, -limit, limit).

    Args:
        layers: Weights [out, in] and biases [out], from the observation on.
        activation: A name in `ACTIVATIONS`, between the layers.
        scaling: mean [in] and sd [in] of the observation; empty for none.
        limit: Standard deviations beyond which an observation is cut off.
    """

    def __init__(
        self,
        layers: Sequence[Tuple[np.ndarray, np.ndarray]],
        activation: str,
        scaling: Sequence[np.ndarray] = (),
        limit: float = 0.0,
    ) -> None:
        single = [(np.array(w, np.float32, order="C"), np.array(b, np.float32)) for w, b in layers]
        self._layers = [(weight, bias, np.empty_like(bias)) for weight, bias in single]
        self._activate = ACTIVATIONS[activation]
        self._scaling = tuple(np.array(row, np.float32) for row in scaling)
        self._limit = np.float32(limit)
        self._scaled = np.empty(self.inputs, np.float32)

    @property
    def inputs(self) -> int:
        """Numbers of an observation."""
        return self._layers[0][0].shape[1]

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """The mean command [2], unbounded, of an observation [inputs]; kept until the next call."""
        values, last = self._standardised(observation), self._layers[-1]
        for layer in self._layers:
            weight, bias, out = layer
            np.dot(weight, values, out=out)
            out += bias
            if layer is not last:
                self._activate(out)
            values = out
        return values

    def _standardised(self, observation: np.ndarray) -> np.ndarray:
        if not self._scaling:
            return observation
        mean, sd = self._scaling
        scaled = self._scaled
        np.subtract(observation, mean, out=scaled)
        np.divide(scaled, sd, out=scaled)
        np.minimum(scaled, self._limit, out=scaled)
        np.maximum(scaled, -self._limit, out=scaled)
        return scaled
