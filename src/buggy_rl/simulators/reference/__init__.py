"""The reference car: a double-track model that stands in for the physical car."""

from buggy_rl.simulators.reference.engine import ReferenceEngine

__all__ = ["ReferenceEngine"]
