"""A user's own simulator from a pair of functions or a Gymnasium environment."""

from buggy_rl.simulators.adapters.functions import FunctionsEngine, from_step
from buggy_rl.simulators.adapters.gymnasium_car import from_gymnasium

__all__ = ["FunctionsEngine", "from_gymnasium", "from_step"]
