"""Plants as PyTorch runs them; `tests/core/test_kernels.py` compares kernels with that."""

import pytest


@pytest.fixture(scope="module", autouse=True)
def plain(without_kernels):
    """Without kernels: cars are compared to the last bit, and lines of PyTorch are what is read."""
