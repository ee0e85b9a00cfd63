"""The reference car: a double-track car that plays the physical platform where there is none."""

from buggy_rl.engines.reference.engine import ReferenceEngine

__all__ = ["ReferenceEngine"]
