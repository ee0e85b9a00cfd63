"""Learned models are trained: their gradients are recorded."""

import pytest


@pytest.fixture(scope="module", autouse=True)
def gradients():
    """As usual."""
