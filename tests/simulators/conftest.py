"""Simulators by kernels where there are; `tests/core/test_kernels.py` has them beside PyTorch."""

from functools import partial

import pytest

from buggy_rl.core.kernels import Kernel, _Module


@pytest.fixture(scope="module", autouse=True)
def gradients(without_gradients):
    """None, so that kernels run; what needs some has a fixture of this name of its own."""


@pytest.fixture
def packaged(monkeypatch):
    """Patches kernels when it is called: PyTorch runs what is compiled, from its own layout."""

    def compiled(kernel, _):
        return partial(kernel._run, lambda given: _Module(kernel)(*given))

    return lambda: monkeypatch.setattr(Kernel, "compiled", compiled)
