"""From recordings of a small car to simulators of it, policies, and the physics left out."""

__version__ = "0.1.0"
