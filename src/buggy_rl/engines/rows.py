"""Engines that compute in rows: tensors in, arrays [n, ...] beneath, tensors out."""

from typing import Any

import torch
from torch import Tensor

from buggy_rl.engines.base import Engine


class RowsEngine(Engine):
    """An engine whose environments are the rows of arrays, by default NumPy's, on the CPU."""

    def _array(self, tensor: Tensor) -> Any:
        """A tensor as the array that this engine computes with: float64, of NumPy."""
        return tensor.detach().to("cpu", torch.float64).numpy()

    def _rows(self, tensor: Tensor) -> Any:
        """A tensor [*batch, ...] as rows [n, ...]."""
        inner = tensor.shape[len(self.batch_size) :]
        return self._array(tensor.reshape(-1, *inner))

    def _tensor(self, rows: Any) -> Tensor:
        """Rows [n, ...] as a tensor [*batch, ...]."""
        return torch.as_tensor(rows).reshape(self._shape(*rows.shape[1:])).to(self.device)
