"""Effects by kernels where there are; `tests/core/test_kernels.py` compares them with PyTorch."""

import pytest


@pytest.fixture(scope="module", autouse=True)
def gradients(without_gradients):
    """None, so that kernels run; what needs some has a fixture of this name of its own."""
