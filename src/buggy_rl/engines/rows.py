"""Engines that compute outside PyTorch: tensors in, rows of float64 beneath, tensors out."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from buggy_rl.engines.base import Engine


class RowsEngine(Engine):
    """An engine whose environments are the rows of NumPy arrays, on the CPU."""

    def _rows(self, tensor: Tensor) -> NDArray:
        """A tensor [*batch, ...] as float64 rows [n, ...]."""
        inner = tensor.shape[len(self.batch_size) :]
        return tensor.detach().to("cpu", torch.float64).reshape(-1, *inner).numpy()

    def _tensor(self, rows: NDArray) -> Tensor:
        """Rows [n, ...] as a tensor [*batch, ...]."""
        tensor = torch.from_numpy(np.ascontiguousarray(rows))
        return tensor.reshape(*self.batch_size, *rows.shape[1:]).to(self.device)
